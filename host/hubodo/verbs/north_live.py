"""The live part of `hubodo north`: a table is turned from stop to stop while the node on it is recorded."""

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
from hubodo.sensors.north.east import FEWEST_STEPS, STOPS_A_STEP, East, seek_east
from hubodo.sensors.north.find import North, horizontal_rate
from hubodo.sensors.north.mount import Mount, mount_of
from hubodo.sensors.north.table import HandTable, SerialTable, Turntable
from hubodo.sensors.north.tally import Tally
from hubodo.version import __version__

SETTLE_S = 1.0
"""After a turn, before a stop counts: the transient of a table on a bench."""
TABLE_ANSWER_S = 2.0
"""For a table to answer a line."""
_TABLE_BAUD = 115200
_LOOK_S = 1.0
_FEWEST_STOPS = 4
_FEWEST_SAMPLES, _TRIES = 20, 3
"""Samples that make a stop, and how often it is made again where fewer came."""


@dataclass(frozen=True)
class LiveProgramme:
    """What was recorded, the node's name, and where the loop of `east` came to rest (axis frame)."""

    recording: Recording
    node: str
    east: East | None
    east_table_angle: float | None


def check_live(args: argparse.Namespace) -> None:
    """Raises InputError for what cannot be done live, before anything moves."""
    if args.method == "carousel":
        raise InputError(
            "--live makes stops; for a carousel record with hubodo record and put table.csv beside it"
        )
    if args.simulate_azimuth_deg is not None:
        raise InputError("--simulate-azimuth-deg goes with a LOG, not with --live")
    if len(args.axis or ["x"]) > 1 and args.method == "east":
        raise InputError("--method east turns one axis to the east; give one --axis")
    if len(args.node or []) > 1:
        raise InputError("--live takes one node; give one --node")
    if args.stops < _FEWEST_STOPS or not args.stop >= 1.0:
        raise InputError(f"--stops {args.stops} --stop {args.stop:g}: give 4 stops of 1 s at least")
    if args.method == "east" and args.stops < FEWEST_STEPS * STOPS_A_STEP:
        raise InputError(f"--stops {args.stops}: east-seeking takes 12 at least, three for each step")
    if args.output is not None and args.output.suffix != ".mcap":
        raise InputError(f"{args.output}: the log is an MCAP file; choose a name that ends in .mcap")
    horizontal_rate(math.radians(args.latitude_deg))


def run_live(
    args: argparse.Namespace,
    angles: tuple[float, ...],
    calibration: Calibration | None,
    earlier: Mapping[str, North],
) -> LiveProgramme:
    """Make the method's stops, record them, and read the record again.

    angles: rad, of the stops, begun anew when they are through. earlier: by axis, what the records before
    this one told. Raises InputError and LinkError of node and table; what was recorded until then stays in
    `--output`.
    """
    node = args.node[0] if args.node else None
    metadata = {"hubodo": __version__, "verb": "north", "ports": args.live}
    with contextlib.ExitStack() as stack:
        table = stack.enter_context(_table(args.table))
        out = args.output
        if out is None:
            out = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="hubodo-north-"))) / "log.mcap"
        found = turned = None
        stream = NodeStream(args.live, out, node=node, metadata=metadata, say=_say)
        try:
            with stream:
                session = _Session(args, stream, table, calibration, earlier)
                if args.method == "east":
                    found, turned = session.seek()
                else:
                    session.stops(angles)
        except BaseException:
            if args.output is not None and out.exists():
                _say(f"what was recorded is in {out}; go on with --resume {out} and another -o")
            raise
        assert stream.node is not None
        return LiveProgramme(read_recording(out), stream.node, found, turned)


class _Session:
    """Turning, waiting and measuring, and the account of it in the log."""

    def __init__(
        self,
        args: argparse.Namespace,
        stream: NodeStream,
        table: Turntable,
        calibration: Calibration | None,
        earlier: Mapping[str, North],
    ) -> None:
        self._args, self._stream, self._table, self._calibration = args, stream, table, calibration
        self._earlier = earlier
        self._axes: list[str] = args.axis or ["x"]
        self._settle = SETTLE_S if args.settle is None else args.settle
        self._wanted = None if args.sigma_deg is None else math.radians(args.sigma_deg)
        self._done = 0
        self._asked = self._angle = math.nan
        self._correction: SampleCorrection | None = None

    def stops(self, angles: tuple[float, ...]) -> None:
        """One stop at each of `angles`, rad, over and over; at most --stops, or until sigma is reached."""
        done = max((sum(map(len, north.stops)) for north in self._earlier.values()), default=0)
        self._turn(angles[done % len(angles)])
        mounts = {axis: self._mount(axis) for axis in self._axes}
        tallies = {axis: self._tally(axis, mounts[axis]) for axis in self._axes}
        for count in range(self._args.stops):
            self._turn(angles[(done + count) % len(angles)])
            t, gyro, _ = self._measure(self._args.stop)
            for axis, tally in tallies.items():
                tally.add(t, gyro[:, "xyz".index(axis)], self._angle + mounts[axis].mounting)
            if (count + 1) % len(angles) == 0 and self._reached(list(tallies.values())):
                break

    def seek(self) -> tuple[East, float]:
        """The loop that turns the axis to the east; leaves it there. Gives the table's angle there too."""
        axis = self._axes[0]
        self._turn(0.0)
        mount = self._mount(axis)
        session = self

        class AxisTable:
            """The table in angles of the axis instead of its own."""

            def turn_to(self, angle: float) -> float:
                session._turn(angle - mount.mounting)
                return session._angle + mount.mounting

        def measure(duration: float) -> tuple[Array, Array]:
            t, gyro, _ = session._measure(duration)
            return t, gyro[:, "xyz".index(axis)]

        found = seek_east(
            AxisTable(),
            measure,
            self._horizontal(mount),
            stop=self._args.stop,
            steps=self._args.stops // STOPS_A_STEP,
            sigma=self._wanted,
            tally=self._tally(axis, mount),
        )
        self._turn(found.angle - mount.mounting)
        return found, self._angle

    def _horizontal(self, mount: Mount) -> float:
        return horizontal_rate(math.radians(self._args.latitude_deg)) * mount.level

    def _tally(self, axis: str, mount: Mount) -> Tally:
        earlier = self._earlier[axis].averages if axis in self._earlier else ()
        near = None if self._args.near_deg is None else math.radians(self._args.near_deg)
        return Tally(self._horizontal(mount), earlier, near)

    def _reached(self, tallies: Sequence[Tally]) -> bool:
        """Whether the axes together know azimuth as well as asked for; says how well."""
        if self._wanted is None:
            return False
        known = [azimuth for azimuth in (tally.azimuth() for tally in tallies) if azimuth is not None]
        if not known:
            return False
        sigma = sum(sigma**-2 for _, sigma in known) ** -0.5
        _say(f"azimuth {math.degrees(known[0][0]) % 360:.2f}° ± {math.degrees(sigma):.2f}° so far")
        return bool(sigma <= self._wanted)

    def _mount(self, axis: str) -> Mount:
        """Raises InputError when the axis is too steep, before the table makes all its stops."""
        _, gyro, accel = self._measure(_LOOK_S, count=False)
        return mount_of(gyro, accel, axis)

    def _turn(self, angle: float) -> None:
        """Nothing where the table stands there already; else turns, notes it in the log, lets it settle."""
        if angle == self._asked:
            return
        if not math.isnan(self._angle):
            self._stream.table(self._angle, moving=True)
        self._angle = self._table.turn_to(angle)
        self._asked = angle
        self._stream.table(self._angle, moving=False)
        self._stream.measure(self._settle)

    def _measure(self, duration: float, *, count: bool = True) -> tuple[Array, Array, Array]:
        """t (N,) s, gyro (N, 3) rad/s and accel (N, 3) m/s², calibrated."""
        if count:
            self._done += 1
            degrees = math.degrees(self._angle) % 360
            _say(f"stop {self._done}, at {degrees:.1f}°: {duration:.0f} s; do not touch the table")
        samples = self._samples(duration)
        if self._correction is None:
            self._correction = self._known()
        # Neither age nor temperature: they move the bias, which turning about takes out here; the log that is
        # read in the end has both.
        gyro, accel = self._correction.apply(samples.gyro, samples.accel)
        return samples.t, gyro, accel

    def _samples(self, duration: float) -> Samples:
        """Measured again where a computer that is too busy lost them. Raises LinkError when that goes on."""
        for left in reversed(range(_TRIES)):
            samples = self._stream.measure(duration)
            if len(samples.t) >= _FEWEST_SAMPLES:
                return samples
            if left:
                _say(f"{len(samples.t)} samples in {duration:g} s: measured again")
        raise LinkError(
            f"{self._args.live}: {len(samples.t)} samples in {duration:g} s, {_TRIES} times; "
            "hubodo doctor looks for what loses them"
        )

    def _known(self) -> SampleCorrection:
        """Raises InputError and CalibrationError for a calibration of another node, before all stops."""
        if self._calibration is None:
            return SampleCorrection.from_calibration(NodeCalibration())
        name, known = self._stream.node or "", self._calibration.nodes
        if name not in known:
            raise InputError(f"--calibration holds no node {name!r}; it has {', '.join(known) or 'none'}")
        check_serial(name, known[name], self._stream.serial)
        return SampleCorrection.from_calibration(known[name])


@contextlib.contextmanager
def _table(port: str | None) -> Iterator[Turntable]:
    """The table on a serial port, asked once whether it is one; or one that is turned by hand."""
    if port is None:
        yield HandTable(_ask)
        return
    try:
        line = serial.Serial(port, _TABLE_BAUD, timeout=TABLE_ANSWER_S, exclusive=True)
    except (OSError, ValueError) as error:
        raise LinkError(f"--table {port}: {error}; check the port and who else has it open") from error
    with line:
        yield SerialTable(line)


def _ask(line: str) -> str:
    """Asks on stderr, as stdout is for the result."""
    print(line, end="", file=sys.stderr, flush=True)
    return input()


def _say(line: str) -> None:
    print(line, file=sys.stderr)
