"""A log in any of its forms: an MCAP file, a rosbag2 folder, a folder of CSV files."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hubodo.errors import InputError
from hubodo.log.convert import write_recording
from hubodo.log.csv_folder import Progress, read_folder
from hubodo.log.mcap import read_recording
from hubodo.recording import Recording

_ROSBAG2 = "metadata.yaml"


def read_log(path: Path, *, progress: Progress | None = None) -> Recording:
    """Read a whole log. Raises LogError or InputError as `read_recording` and `read_folder` do."""
    file = mcap_file(path)
    return read_folder(path, progress=progress) if file is None else read_recording(file, progress=progress)


@contextmanager
def as_mcap(path: Path) -> Iterator[Path]:
    """The log as an MCAP file; of a CSV folder one that is gone afterwards."""
    file = mcap_file(path)
    if file is not None:
        yield file
        return
    with tempfile.TemporaryDirectory(prefix="hubodo-") as folder:
        made = Path(folder) / f"{path.absolute().name}.mcap"
        write_recording(read_folder(path), made)
        yield made


def mcap_file(path: Path) -> Path | None:
    """The MCAP file that a path means; None for a CSV folder."""
    if not path.is_dir():
        return path
    if not (path / _ROSBAG2).exists():
        return None
    files = sorted(path.glob("*.mcap"))
    if len(files) == 1:
        return files[0]
    if files:
        raise InputError(f"{path}: a rosbag2 folder in {len(files)} parts; name one: {files[0].name}, ...")
    raise InputError(f"{path}: a rosbag2 folder without an .mcap file; make one with ros2 bag convert")
