"""Folders of `table_record` as the command line reads them: a node, and table.csv if there is one."""

import numpy as np

from generators.table_record import table_record, table_rows
from hubodo.log.csv_folder import write_folder
from hubodo.recording import Recording, Table


def write_record(path, programme, rng, *, table=True, row_step=0.1, lag=0.0, **world):
    """Write the folder and return its path; lag: delay of the clock of table.csv, s."""
    t, gyro, accel, _ = table_record(programme, rng, **world)
    columns = dict(zip(("t", "gx", "gy", "gz", "ax", "ay", "az"), (t, *gyro.T, *accel.T), strict=True))
    rows = None
    if table:
        rows = Table(
            dict(zip(("t", "angle", "moving"), table_rows(programme, step=row_step, lag=lag), strict=True))
        )
    write_folder(Recording({"imu": Table(columns)}, table=rows), path)
    return path


def wrapped(degrees):
    """Return degrees in (-180, 180]."""
    return (np.asarray(degrees) + 180.0) % 360.0 - 180.0
