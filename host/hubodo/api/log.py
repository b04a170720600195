"""A log as Python programs use it: read once, looked at as arrays, handed to what the verbs do."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from hubodo.errors import InputError
from hubodo.html_table import html_lines, html_table
from hubodo.recording import Event, Recording, Table

# The rest is loaded by what needs it: a log is open in a quarter of the time that everything takes.
if TYPE_CHECKING:
    import pandas as pd

    from hubodo.api.given import StrPath
    from hubodo.api.missing import MissingEffects
    from hubodo.api.plot import Plot
    from hubodo.api.sensor import AllanResult, WarmupResult
    from hubodo.api.track import FusedTrack
    from hubodo.calibration.file import Calibration
    from hubodo.fuse.wheel_odometry import Method
    from hubodo.model.model_file import Model
    from hubodo.vehicle import Vehicle

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
        """The nodes by name: `t,gx,gy,gz,ax,ay,az[,temperature][,supply]`, in s, rad/s, m/s², °C, V."""
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
        from hubodo.ingest.replay.odometry_setup import read_odometry_setup
        from hubodo.log.any_log import open_source
        from hubodo.log.logfile import Log

        with open_source(self.path) as source:
            return read_odometry_setup(source).vehicle if isinstance(source, Log) else None

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
        from hubodo.api.given import given_calibration, given_vehicle
        from hubodo.api.track import fused_track
        from hubodo.fuse.fusion import fuse_recording

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

    def allan(
        self,
        node: str | None = None,
        channel: str = "gz",
        *,
        start: float | None = None,
        end: float | None = None,
        per_octave: int = 1,
        turn: float = 2.0,
        as_is: bool = False,
        trust_units: bool = False,
    ) -> AllanResult:
        """What a sensor at rest is worth: what `hubodo allan` computes.

        >>> import hubodo
        >>> allan = hubodo.open("night.mcap").allan("left", "gz")
        >>> f"{allan.terms['N'].value:.1e} rad/√s"
        '1.4e-04 rad/√s'

        Args:
            node: whose; None: the only one.
            channel: `gx` to `gz`, `ax` to `az`.
            start: leave out what is before this time of the log, s.
            end: leave out what is after it, s.
            per_octave: averaging times per octave.
            turn: s from stop to stop of a turntable, for the advice on maytagging.
            as_is: every sample, whatever it is: the plain deviation, as allantools has it.
            trust_units: do not judge the unit by the magnitude.

        Raises:
            InputError: no such node or channel, samples in wrong units, a sensor that moved, too few samples.
        """
        from hubodo.api.sensor import allan_of
        from hubodo.sensors.standstill_channel import read_standstill_channel

        rest = read_standstill_channel(
            self.recording,
            self._node(node),
            channel,
            log=str(self.path),
            start=start,
            end=end,
            trust_units=trust_units,
            trust_still=as_is,
            cut_disturbances=True,
        )
        return allan_of(rest, str(self.path), turn=turn, per_octave=per_octave, every_sample=as_is)

    def warmup(
        self,
        node: str | None = None,
        channel: str = "gz",
        *,
        age: float = 0.0,
        start: float | None = None,
        end: float | None = None,
        trust_units: bool = False,
    ) -> WarmupResult:
        """The bias of a gyro axis after power-on: what `hubodo warmup` computes.

        Args:
            node: whose; None: the only one.
            channel: `gx`, `gy` or `gz`.
            age: s since power-on at the first sample.
            start: leave out what is before this time of the log, s.
            end: leave out what is after it, s.
            trust_units: do not judge the unit by the magnitude.

        Raises:
            InputError: no such node or axis, samples in wrong units, a sensor that moved, too few samples.
        """
        from hubodo.api.sensor import warmup_of
        from hubodo.sensors.standstill_channel import IMU_CHANNELS, read_standstill_channel

        if channel not in IMU_CHANNELS[:3]:
            raise InputError(f"channel {channel!r}: choose from {', '.join(IMU_CHANNELS[:3])}")
        rest = read_standstill_channel(
            self.recording,
            self._node(node),
            channel,
            log=str(self.path),
            start=start,
            end=end,
            trust_units=trust_units,
        )
        return warmup_of(rest, str(self.path), age=age)

    def gap(
        self,
        model: StrPath | Model | None = None,
        *,
        accept: Sequence[str] = (),
        reject: Sequence[str] = (),
    ) -> MissingEffects:
        """What a model lacks to explain this log: what `hubodo gap` finds.

        Args:
            model: a model file, or a `Model`; None: the vehicle of this log, with noise and inputs as the log
                shows them.
            accept: effects that are added before anything is searched.
            reject: effects that are not considered; `empirical`: no term without a name.

        Raises:
            InputError: a log that has not what the model needs, or an effect that there is not.
            ConfigError: a model file with a mistake in it.
        """
        from hubodo.api.given import given_model
        from hubodo.api.missing import MissingEffects, check_effects
        from hubodo.gap.problem.assumed import assume_model
        from hubodo.gap.workflow import find_gap
        from hubodo.progress import progress_line

        check_effects(accept, reject)
        if model is not None:
            known = given_model(model)
        elif self.vehicle is not None:
            known = assume_model(self.recording, self.vehicle, str(self.path))
        else:
            raise InputError(f"{self.path}: carries no vehicle; name a model file")
        with progress_line() as show:
            result = find_gap(
                self.recording,
                known,
                accept=accept,
                reject=reject,
                log_name=str(self.path),
                report_progress=show,
            )
        if not result.is_finished:
            raise KeyboardInterrupt("the search was stopped before its end")
        given = Path(model).name if isinstance(model, str | os.PathLike) else "the model"
        return MissingEffects(result, self.path.name, given)

    def plot(self, channel: str = "gz") -> Plot:
        """A column of all nodes over time. Raises InputError where no node has it."""
        from hubodo.api.plot import Plot
        from hubodo.report.curves import Curve, curves_figure
        from hubodo.report.page import COLOURS

        shown = [
            Curve(table.t, table[channel], name, COLOURS.get(name, _HUES[k % len(_HUES)]), 1.0)
            for k, (name, table) in enumerate(self.nodes.items())
            if channel in table
        ]
        if not shown:
            raise InputError(f"{self.path}: no node has a column {channel!r}")
        unit = {"g": "rad/s", "a": "m/s²"}.get(channel[0], "") if len(channel) == 2 else ""
        return Plot(curves_figure(shown, "time, s", f"{channel}, {unit}" if unit else channel))

    def save(self, path: StrPath) -> Path:
        """Write it as an MCAP file (`.mcap`) or as a folder of CSV files; nothing is overwritten.

        Raises InputError where something is there already.
        """
        from hubodo.log.csv_folder import write_folder
        from hubodo.log.recording_writer import write_recording

        target = Path(path)
        if target.exists():
            raise InputError(f"{target}: exists already; choose another name, nothing is overwritten")
        if target.suffix == ".mcap":
            write_recording(self.recording, target, vehicle=self._vehicle)
        else:
            write_folder(self.recording, target)
        return target

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
