"""`hubodo north --live`: turn a table from stop to stop while recording the node on it."""

from __future__ import annotations

import argparse
import contextlib
import math
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import serial

from hubodo.arrays import Array
from hubodo.calibration.apply import SampleCorrection, check_serial
from hubodo.calibration.file import Calibration, NodeCalibration
from hubodo.errors import InputError, LinkError
from hubodo.ingest.live.node_stream import NodeStream, Samples
from hubodo.log.recording_reader import read_recording
from hubodo.recording import Recording
from hubodo.sensors.north.east import MIN_EAST_STEPS, STOPS_PER_STEP, EastSeekResult, seek_east
from hubodo.sensors.north.mount import AxisMount, estimate_mount
from hubodo.sensors.north.north_estimate import NorthEstimate, horizontal_earth_rate
from hubodo.sensors.north.running_estimate import RunningEstimate
from hubodo.sensors.north.turntable import ManualTable, SerialTable, Turntable
from hubodo.version import __version__

SETTLE_S = 1.0  # s
"""Settling time of a bench table after a turn, before a stop counts."""
TABLE_TIMEOUT_S = 2.0  # s
"""Longest wait for the answer of a table to a command."""
_TABLE_BAUD = 115200
_LEVEL_CHECK_S = 1.0
_MIN_STOPS = 4
_MIN_STOP_SAMPLES, _MAX_ATTEMPTS = 20, 3
"""Fewest samples of a valid stop, and how often a stop is measured before it fails."""


@dataclass(frozen=True)
class LiveRecording:
    """The recording of a live run.

    Attributes
    ----------
    recording
        The recorded log, read again.
    node
        Name of the node.
    east
        Result of the east-seeking loop, axis frame; None for other methods.
    east_table_angle
        Final table angle of the loop, rad.
    """

    recording: Recording
    node: str
    east: EastSeekResult | None
    east_table_angle: float | None


def check_live_options(args: argparse.Namespace) -> None:
    """Raise InputError for options that do not work live, before the table moves."""
    if args.method == "carousel":
        raise InputError(
            "--live makes stops; for a carousel use hubodo record and put table.csv beside the log"
        )
    if args.simulate_azimuth_deg is not None:
        raise InputError("--simulate-azimuth-deg goes with a LOG, not with --live")
    if len(args.axis or ["x"]) > 1 and args.method == "east":
        raise InputError("--method east turns one axis to the east; give one --axis")
    if len(args.node or []) > 1:
        raise InputError("--live takes one node; give one --node")
    if args.stops < _MIN_STOPS or not args.stop >= 1.0:
        raise InputError(f"--stops {args.stops} --stop {args.stop:g}: give at least 4 stops of at least 1 s")
    if args.method == "east" and args.stops < MIN_EAST_STEPS * STOPS_PER_STEP:
        raise InputError(f"--stops {args.stops}: east-seeking needs at least 12, three for each step")
    if args.output is not None and args.output.suffix != ".mcap":
        raise InputError(f"{args.output}: the log is an MCAP file; choose a name with the suffix .mcap")
    horizontal_earth_rate(math.radians(args.latitude_deg))


def record_live(
    args: argparse.Namespace,
    angles: tuple[float, ...],
    calibration: Calibration | None,
    previous: Mapping[str, NorthEstimate],
) -> LiveRecording:
    """Make the stops of the method, record them, and read the log again.

    angles: table angles of the stops, rad, repeated in turn. previous: by axis, the north estimate of logs
    that this run continues. Raises InputError and LinkError of node and table; what was recorded until then
    stays in `--output`.
    """
    node = args.node[0] if args.node else None
    metadata = {"hubodo": __version__, "verb": "north", "ports": args.live}
    with contextlib.ExitStack() as stack:
        table = stack.enter_context(_open_table(args.table))
        out = args.output
        if out is None:
            out = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="hubodo-north-"))) / "log.mcap"
        east = table_angle = None
        stream = NodeStream(args.live, out, node=node, metadata=metadata, on_notice=_print_line)
        try:
            with stream:
                session = _Session(args, stream, table, calibration, previous)
                if args.method == "east":
                    east, table_angle = session.seek_east()
                else:
                    session.make_stops(angles)
        except BaseException:
            if args.output is not None and out.exists():
                _print_line(
                    f"the recording until now is in {out}; continue with --resume {out} and another -o"
                )
            raise
        assert stream.node is not None
        return LiveRecording(read_recording(out), stream.node, east, table_angle)


class _Session:
    """A live session: turns the table, waits, measures, and logs the table angle."""

    def __init__(
        self,
        args: argparse.Namespace,
        stream: NodeStream,
        table: Turntable,
        calibration: Calibration | None,
        earlier: Mapping[str, NorthEstimate],
    ) -> None:
        self._args, self._stream, self._table, self._calibration = args, stream, table, calibration
        self._earlier = earlier
        self._axes: list[str] = args.axis or ["x"]
        self._settle = SETTLE_S if args.settle is None else args.settle
        self._target_sigma = None if args.sigma_deg is None else math.radians(args.sigma_deg)
        self._stop_count = 0
        self._target = self._angle = math.nan
        self._correction: SampleCorrection | None = None

    def make_stops(self, angles: tuple[float, ...]) -> None:
        """Stop at each of `angles` (rad) in turn, until --stops or the requested sigma is reached."""
        previous = max((sum(map(len, north.stops)) for north in self._earlier.values()), default=0)
        self._turn_table(angles[previous % len(angles)])
        mounts = {axis: self._mount(axis) for axis in self._axes}
        tallies = {axis: self._tally(axis, mounts[axis]) for axis in self._axes}
        for count in range(self._args.stops):
            self._turn_table(angles[(previous + count) % len(angles)])
            t, gyro, _ = self._measure(self._args.stop)
            for axis, tally in tallies.items():
                tally.add_stop(t, gyro[:, "xyz".index(axis)], self._angle + mounts[axis].mounting_angle)
            if (count + 1) % len(angles) == 0 and self._is_sigma_reached(list(tallies.values())):
                break

    def seek_east(self) -> tuple[EastSeekResult, float]:
        """Turn the axis east in a closed loop; return the result and the final table angle, rad."""
        axis = self._axes[0]
        self._turn_table(0.0)
        mount = self._mount(axis)
        session = self

        class AxisTable:
            """The table in axis angles instead of table angles."""

            def turn_to(self, angle: float) -> float:
                session._turn_table(angle - mount.mounting_angle)
                return session._angle + mount.mounting_angle

        def measure(duration: float) -> tuple[Array, Array]:
            t, gyro, _ = session._measure(duration)
            return t, gyro[:, "xyz".index(axis)]

        east = seek_east(
            AxisTable(),
            measure,
            self._horizontal(mount),
            stop=self._args.stop,
            steps=self._args.stops // STOPS_PER_STEP,
            sigma=self._target_sigma,
            tally=self._tally(axis, mount),
        )
        self._turn_table(east.angle - mount.mounting_angle)
        return east, self._angle

    def _horizontal(self, mount: AxisMount) -> float:
        return horizontal_earth_rate(math.radians(self._args.latitude_deg)) * mount.level_share

    def _tally(self, axis: str, mount: AxisMount) -> RunningEstimate:
        earlier = self._earlier[axis].averages if axis in self._earlier else ()
        near = None if self._args.near_deg is None else math.radians(self._args.near_deg)
        return RunningEstimate(self._horizontal(mount), earlier, near)

    def _is_sigma_reached(self, tallies: Sequence[RunningEstimate]) -> bool:
        """Return True if the combined azimuth has the requested sigma; print the estimate so far."""
        if self._target_sigma is None:
            return False
        estimates = [azimuth for azimuth in (tally.azimuth() for tally in tallies) if azimuth is not None]
        if not estimates:
            return False
        sigma = sum(sigma**-2 for _, sigma in estimates) ** -0.5
        _print_line(f"azimuth {math.degrees(estimates[0][0]) % 360:.2f}° ± {math.degrees(sigma):.2f}° so far")
        return bool(sigma <= self._target_sigma)

    def _mount(self, axis: str) -> AxisMount:
        """Measure how the axis is mounted; raise InputError early if it is too far from horizontal."""
        _, gyro, accel = self._measure(_LEVEL_CHECK_S, count=False)
        return estimate_mount(gyro, accel, axis)

    def _turn_table(self, angle: float) -> None:
        """Turn the table unless it is already there, log the angle, and let it settle."""
        if angle == self._target:
            return
        if not math.isnan(self._angle):
            self._stream.log_table_angle(self._angle, moving=True)
        self._angle = self._table.turn_to(angle)
        self._target = angle
        self._stream.log_table_angle(self._angle, moving=False)
        self._stream.measure(self._settle)

    def _measure(self, duration: float, *, count: bool = True) -> tuple[Array, Array, Array]:
        """Return t (N,) s, gyro (N, 3) rad/s and accel (N, 3) m/s² of one stop, calibrated."""
        if count:
            self._stop_count += 1
            degrees = math.degrees(self._angle) % 360
            _print_line(
                f"stop {self._stop_count}, at {degrees:.1f}°: {duration:.0f} s; do not touch the table"
            )
        samples = self._samples(duration)
        if self._correction is None:
            self._correction = self._node_correction()
        # Without age and temperature: they only shift the bias, which reversing the axis cancels; the final
        # evaluation of the log uses both.
        gyro, accel = self._correction.apply(samples.gyro, samples.accel)
        return samples.t, gyro, accel

    def _samples(self, duration: float) -> Samples:
        """Measure a stop, again if a busy computer lost samples; raise LinkError if that persists."""
        for attempts_left in reversed(range(_MAX_ATTEMPTS)):
            samples = self._stream.measure(duration)
            if len(samples.t) >= _MIN_STOP_SAMPLES:
                return samples
            if attempts_left:
                _print_line(f"{len(samples.t)} samples in {duration:g} s: measuring again")
        raise LinkError(
            f"{self._args.live}: {len(samples.t)} samples in {duration:g} s, {_MAX_ATTEMPTS} times; "
            "hubodo doctor finds the cause of the losses"
        )

    def _node_correction(self) -> SampleCorrection:
        """Return the node's calibration; raise InputError or CalibrationError if it is for another node."""
        if self._calibration is None:
            return SampleCorrection.from_calibration(NodeCalibration())
        name, nodes = self._stream.node or "", self._calibration.nodes
        if name not in nodes:
            raise InputError(f"--calibration holds no node {name!r}; it has {', '.join(nodes) or 'none'}")
        check_serial(name, nodes[name], self._stream.serial)
        return SampleCorrection.from_calibration(nodes[name])


@contextlib.contextmanager
def _open_table(port: str | None) -> Iterator[Turntable]:
    """Open the table on a serial port and check that it answers, or yield one that is turned by hand."""
    if port is None:
        yield ManualTable(_prompt)
        return
    try:
        line = serial.Serial(port, _TABLE_BAUD, timeout=TABLE_TIMEOUT_S, exclusive=True)
    except (OSError, ValueError) as error:
        raise LinkError(
            f"--table {port}: {error}; check the port and which other program has it open"
        ) from error
    with line:
        yield SerialTable(line)


def _prompt(line: str) -> str:
    """Prompt on stderr, as stdout is for the result, and return the answer."""
    print(line, end="", file=sys.stderr, flush=True)
    return input()


def _print_line(line: str) -> None:
    print(line, file=sys.stderr)
