"""`hubodo.open`: a recording of any form into memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from hubodo.api.given import StrPath, given_vehicle
from hubodo.api.log import LoadedLog
from hubodo.log.any_log import read_log
from hubodo.log.number_recording import InputFormat
from hubodo.log.roles import TopicSelection
from hubodo.progress import progress_line
from hubodo.vehicle import Vehicle


def open(
    path: StrPath,
    *,
    vehicle: StrPath | Vehicle | None = None,
    topics: Mapping[str, str] | None = None,
    rate: float | None = None,
    units: Sequence[str] = (),
    columns: Sequence[str] = (),
    variable: str | None = None,
    channel: str = "gz",
) -> LoadedLog:
    """Read a log: MCAP, rosbag or rosbag2, CSV folder, or one file of numbers (CSV, MATLAB, HDF5, numpy).

    >>> import hubodo
    >>> log = hubodo.open("drive.mcap")
    >>> log
    LoadedLog('drive.mcap': left, right, reference, truth; 60.0 s)
    >>> log["left"]["gz"].shape
    (12000,)
    >>> log.fuse("vehicle.toml").score.final_percent < 1.0
    True

    Args:
        path: the log.
        vehicle: a vehicle file or a `Vehicle`; `fuse` takes it then, and its `[topics]` are used.
        topics: which topic of another program's log is what, as in `{"left": "/imu/left_wheel"}`.
        rate: samples per second, for a file of numbers without times.
        units: of such a file: `deg/s`, `g`, `0.00875 deg/s` for what one count stands for.
        columns: of such a file: what each column is, as in `["t", "gx", "gy", "gz"]`; "-" leaves one out.
        variable: the arrays of a MATLAB, HDF5 or numpy file.
        channel: what the only column of such a file is.

    Raises:
        LogError: no such file, or one that cannot be read.
        InputError: a file that does not say what it is, and is not told by the arguments.
    """
    where = Path(path)
    known = None if vehicle is None else given_vehicle(vehicle)
    choice = TopicSelection(topics or {}, required_roles=frozenset())
    if known is not None:
        on_wheels = {name: mount.side is not None for name, mount in known.nodes.items()}
        choice = TopicSelection(topics or {}, known.topics, on_wheels, known.wheel_radius, frozenset())
    form = InputFormat(rate, tuple(units), tuple(columns), variable, channel, choice)
    with progress_line() as show:
        recording = read_log(where, input_format=form, progress=show)
    return LoadedLog(where, recording, known)
