"""`hubodo.open`, which reads a recording of any supported format into memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from hubodo.api.arguments import StrPath, as_vehicle
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
    """Read a log: MCAP, rosbag or rosbag2, CSV folder, or one numeric file (CSV, MATLAB, HDF5, NumPy).

    Parameters
    ----------
    path : str or path-like
        The log.
    vehicle : str, path-like or Vehicle, optional
        Vehicle for `fuse`; its `[topics]` are used for reading.
    topics : mapping of str to str, optional
        Topic of each node or role in a log of another program, such as `{"left": "/imu/left_wheel"}`.
    rate : float, optional
        Sample rate in Hz of a numeric file without timestamps.
    units : sequence of str
        Units of a numeric file: `deg/s`, `g`, or `0.00875 deg/s` per count.
    columns : sequence of str
        Meaning of each column of a numeric file, such as `["t", "gx", "gy", "gz"]`; "-" ignores one.
    variable : str, optional
        Arrays of a MATLAB, HDF5 or NumPy file.
    channel : str
        Meaning of the only column of a numeric file.

    Returns
    -------
    LoadedLog
        The log in memory.

    Raises
    ------
    LogError
        If the file does not exist or cannot be read.
    InputError
        If metadata that the file lacks is not given.

    Examples
    --------
    >>> import hubodo
    >>> log = hubodo.open("drive.mcap")
    >>> log
    LoadedLog('drive.mcap': left, right, reference, truth; 60.0 s)
    >>> log["left"]["gz"].shape
    (12000,)
    >>> log.fuse("vehicle.toml").score.final_percent < 1.0
    True
    """
    log_path = Path(path)
    used_vehicle = None if vehicle is None else as_vehicle(vehicle)
    topic_selection = TopicSelection(topics or {}, required_roles=frozenset())
    if used_vehicle is not None:
        on_wheels = {name: mount.side is not None for name, mount in used_vehicle.nodes.items()}
        topic_selection = TopicSelection(
            topics or {}, used_vehicle.topics, on_wheels, used_vehicle.wheel_radius, frozenset()
        )
    input_format = InputFormat(rate, tuple(units), tuple(columns), variable, channel, topic_selection)
    with progress_line() as show:
        recording = read_log(log_path, input_format=input_format, progress=show)
    return LoadedLog(log_path, recording, used_vehicle)
