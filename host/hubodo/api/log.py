"""A log as Python programs use it: read once, looked at as arrays, handed to what the verbs do."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from hubodo.api.given import StrPath, given_calibration, given_vehicle
from hubodo.api.plot import Plot
from hubodo.api.track import FusedTrack, fused_track
from hubodo.calibration.file import Calibration
from hubodo.errors import InputError
from hubodo.fuse.fused import fuse_recording
from hubodo.fuse.wheels import Method
from hubodo.html_table import html_lines, html_table
from hubodo.log.any_log import open_source, read_log
from hubodo.log.foreign import LogForm
from hubodo.log.logfile import Log
from hubodo.log.roles import TopicChoice
from hubodo.progress import progress_line
from hubodo.recording import Event, Recording, Table
from hubodo.report.curves import Curve, curves_figure
from hubodo.report.page import COLOURS
from hubodo.vehicle import Vehicle

if TYPE_CHECKING:
    import pandas as pd

_HUES = ("#1b6ca8", "#d1495b", "#2e7d5b", "#7a4fa3", "#8a6d3b", "#1d2126")


class LoadedLog:
    """A log in memory; `hubodo.open` and `hubodo.simulate` make one.

    Its tables are reached by name, as in `log["left"]["gz"]`: nodes by theirs, and `reference`, `wheels`,
    `gnss`, `heading`, `table`, `truth` where the log has them.

    Attributes:
        path: where it was read from; for a simulated one, what it is called.
        recording: everything that was read.
    """

    def __init__(self, path: Path, recording: Recording, vehicle: Vehicle | None = None) -> None:
        self.path = path
        self.recording = recording
        self._vehicle = vehicle

    @property
    def nodes(self) -> Mapping[str, Table]:
        """The nodes by name: `t,gx,gy,gz,ax,ay,az[,temperature]`, in s, rad/s, m/s² and °C."""
        return self.recording.nodes

    @property
    def events(self) -> tuple[Event, ...]:
        """What happened during the recording: gaps, resets, links that came and went."""
        return self.recording.events

    @property
    def warnings(self) -> tuple[str, ...]:
        """One line for each thing that was damaged or left out on reading."""
        return self.recording.warnings

    @property
    def duration(self) -> float:
        """s from the first to the last row of any table."""
        ends = [(table.t[0], table.t[-1]) for table in self.recording.files().values() if len(table)]
        return float(max(b for _, b in ends) - min(a for a, _ in ends)) if ends else 0.0

    @cached_property
    def vehicle(self) -> Vehicle | None:
        """The one given on opening, else the one that the log carries, None where there is neither."""
        if self._vehicle is not None or not self.path.exists():
            return self._vehicle
        from hubodo.ingest.replay.playback import setup_of

        with open_source(self.path) as source:
            return setup_of(source).vehicle if isinstance(source, Log) else None

    def __getitem__(self, name: str) -> Table:
        tables = self.recording.files()
        if name not in tables:
            raise InputError(f"{self.path}: no table {name!r}; it has {', '.join(tables) or 'none'}")
        return tables[name]

    def __contains__(self, name: object) -> bool:
        return name in self.recording.files()

    def __iter__(self) -> Iterator[str]:
        return iter(self.recording.files())

    def __len__(self) -> int:
        return len(self.recording.files())

    def frame(self, name: str | None = None, *, utc: bool = False) -> pd.DataFrame:
        """A table as a data frame of pandas.

        Args:
            name: which; None: the only node.
            utc: index it by UTC instead of by seconds since t = 0.

        Raises:
            InputError: no such table, several nodes, no pandas, or a log that does not tell when it was.
        """
        made = self[self._node(name) if name is None else name].frame()
        if utc:
            if not self.recording.t_zero_ns:
                raise InputError(f"{self.path}: does not tell at which date t = 0 was; leave utc out")
            import pandas as pd

            since = np.rint(np.asarray(made.index, np.float64) * 1e9).astype(np.int64)
            made.index = pd.DatetimeIndex(self.recording.t_zero_ns + since, name="utc", tz="UTC")
        return made

    def fuse(
        self,
        vehicle: StrPath | Vehicle | None = None,
        *,
        calibration: StrPath | Calibration | None = None,
        nodes: Sequence[str] | None = None,
        method: Method = "filter",
        smooth: float | Literal["full"] = 0.0,
        graph: bool = True,
        antenna: tuple[float, float] | None = None,
    ) -> FusedTrack:
        """Where the vehicle went, with sigmas: what `hubodo fuse` computes.

        Args:
            vehicle: a vehicle or model file, or a `Vehicle`; None: the one that the log carries.
            calibration: a file of `hubodo calibrate`, or a `Calibration`.
            nodes: use these wheel nodes alone.
            method: `filter`, or `differential` for plain differential odometry.
            smooth: make each pose from so many seconds after it, too, or from the whole log (`full`).
            graph: let GNSS and headings of the log take part.
            antenna: m of the GNSS antenna forward and left of midway between the wheels.

        Raises:
            InputError: no vehicle, nodes that are missing, a log too short or in wrong units.
            ConfigError: a vehicle or calibration file with a mistake in it.
            CalibrationError: a calibration of another node.
        """
        lag = math.inf if smooth == "full" else float(smooth)
        if not lag >= 0.0:
            raise InputError(f"smooth = {smooth}: give seconds from 0 on, or 'full'")
        if lag > 0.0 and method != "filter":
            raise InputError("smooth goes with method='filter'")
        chosen = self.vehicle if vehicle is None else given_vehicle(vehicle)
        if chosen is None:
            raise InputError(f"{self.path}: carries no vehicle; name a vehicle file")
        known, source = given_calibration(calibration)
        fused = fuse_recording(
            self.recording,
            chosen,
            log=str(self.path),
            method=method,
            nodes=nodes,
            calibration=known,
            calibration_from=source,
            lag=lag,
            graph=graph,
            antenna=antenna,
        )
        return fused_track(fused, self.recording.truth)

    def plot(self, channel: str = "gz") -> Plot:
        """A column of all nodes over time. Raises InputError where no node has it."""
        shown = [
            Curve(table.t, table[channel], name, COLOURS.get(name, _HUES[k % len(_HUES)]), 1.0)
            for k, (name, table) in enumerate(self.nodes.items())
            if channel in table
        ]
        if not shown:
            raise InputError(f"{self.path}: no node has a column {channel!r}")
        unit = {"g": "rad/s", "a": "m/s²"}.get(channel[0], "") if len(channel) == 2 else ""
        return Plot(curves_figure(shown, "time, s", f"{channel}, {unit}" if unit else channel))

    def _node(self, name: str | None) -> str:
        """The node that is meant: the one named, or the only one."""
        nodes = tuple(self.nodes)
        if name is None and len(nodes) == 1:
            return nodes[0]
        if name is None or name not in nodes:
            asked = "which node?" if name is None else f"no node {name!r}"
            raise InputError(f"{self.path}: {asked} It has {', '.join(nodes) or 'none'}")
        return name

    def __repr__(self) -> str:
        return f"LoadedLog({str(self.path)!r}: {', '.join(self) or 'empty'}; {self.duration:.1f} s)"

    def _repr_html_(self) -> str:
        rows = [
            (
                name,
                str(len(table)),
                f"{(len(table) - 1) / (table.t[-1] - table.t[0]):.4g}" if len(table) > 1 else "",
                f"{table.t[0]:.3f} to {table.t[-1]:.3f}",
                " ".join(table),
            )
            for name, table in self.recording.files().items()
        ]
        return html_table(("", "rows", "Hz", "t, s", "columns"), rows) + html_lines(self.warnings)


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
    choice = TopicChoice(topics or {}, needed=frozenset())
    if known is not None:
        on_wheels = {name: mount.side is not None for name, mount in known.nodes.items()}
        choice = TopicChoice(topics or {}, known.topics, on_wheels, known.wheel_radius, frozenset())
    form = LogForm(rate, tuple(units), tuple(columns), variable, channel, choice)
    with progress_line() as show:
        recording = read_log(where, form=form, progress=show)
    return LoadedLog(where, recording, known)
