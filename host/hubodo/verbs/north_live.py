"""The live part of `hubodo north`: a table is turned from stop to stop while the node on it is recorded."""

from __future__ import annotations

import argparse
import contextlib
import math
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import serial
from numpy.typing import NDArray

from hubodo import __version__
from hubodo.calibration.apply import SampleCorrection
from hubodo.calibration.file import Calibration, NodeCalibration
from hubodo.errors import InputError, LinkError
from hubodo.ingest.live.node_stream import NodeStream
from hubodo.log.mcap import read_recording
from hubodo.recording import Recording
from hubodo.sensors.north.east import East, seek_east
from hubodo.sensors.north.find import horizontal_rate
from hubodo.sensors.north.mount import Mount, mount_of
from hubodo.sensors.north.table import HandTable, SerialTable, Turntable

Array = NDArray[np.float64]

SETTLE_S = 1.0
"""After a turn, before a stop counts: the transient of a table on a bench."""
TABLE_HELLO_S = 3.0
"""For a table to answer at all; it gets longer to turn."""
_TABLE_BAUD, _TABLE_ANSWER_S = 115200, 120.0
_LOOK_S = 1.0
_FEWEST_STOPS, _FEWEST_STEPS, _STOPS_A_STEP = 4, 4, 3


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
    if args.method == "east" and args.stops < _FEWEST_STEPS * _STOPS_A_STEP:
        raise InputError(f"--stops {args.stops}: east-seeking takes 12 at least, three for each step")
    if args.output is not None and args.output.suffix != ".mcap":
        raise InputError(f"{args.output}: the log is an MCAP file; choose a name that ends in .mcap")
    horizontal_rate(math.radians(args.latitude_deg))


def run_live(
    args: argparse.Namespace, angles: tuple[float, ...], calibration: Calibration | None
) -> LiveProgramme:
    """Make the method's stops, record them, and read the record again.

    angles: rad, of the stops, begun anew when they are through. Raises InputError and LinkError of node and
    table; what was recorded until then stays in `--output`.
    """
    node = args.node[0] if args.node else None
    metadata = {"hubodo": __version__, "verb": "north", "ports": args.live}
    with contextlib.ExitStack() as stack:
        table = stack.enter_context(_table(args.table))
        out = args.output
        if out is None:
            out = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="hubodo-north-"))) / "log.mcap"
        found = turned = None
        with NodeStream(args.live, out, node=node, metadata=metadata, say=_say) as stream:
            session = _Session(args, stream, table, calibration)
            if args.method == "east":
                found, turned = session.seek()
            else:
                session.stops(np.resize(angles, args.stops))
        assert stream.node is not None
        return LiveProgramme(read_recording(out), stream.node, found, turned)


class _Session:
    """Turning, waiting and measuring, and the account of it in the log."""

    def __init__(
        self, args: argparse.Namespace, stream: NodeStream, table: Turntable, calibration: Calibration | None
    ) -> None:
        self._args, self._stream, self._table, self._calibration = args, stream, table, calibration
        self._settle = SETTLE_S if args.settle is None else args.settle
        self._done = 0
        self._angle = math.nan

    def stops(self, angles: Array) -> None:
        """One stop at each angle, rad."""
        self._turn(float(angles[0]))
        for axis in self._args.axis or ["x"]:
            self._mount(axis)
        for angle in angles:
            self._turn(float(angle))
            self._measure(self._args.stop)

    def seek(self) -> tuple[East, float]:
        """The loop that turns the axis to the east; leaves it there. Gives the table's angle there too."""
        axis = (self._args.axis or ["x"])[0]
        self._turn(0.0)
        mount = self._mount(axis)
        session = self

        class AxisTable:
            """The table in angles of the axis instead of its own."""

            def turn_to(self, angle: float) -> None:
                session._turn(angle - mount.mounting)

        def measure(duration: float) -> tuple[Array, Array]:
            t, gyro, _ = session._measure(duration)
            return t, gyro[:, "xyz".index(axis)]

        steps = self._args.stops // _STOPS_A_STEP
        latitude = math.radians(self._args.latitude_deg)
        found = seek_east(AxisTable(), measure, latitude, stop=self._args.stop, steps=steps)
        self._turn(found.angle - mount.mounting)
        return found, self._angle

    def _mount(self, axis: str) -> Mount:
        """Raises InputError when the axis is too steep, before the table makes all its stops."""
        _, gyro, accel = self._measure(_LOOK_S, count=False)
        return mount_of(gyro, accel, axis)

    def _turn(self, angle: float) -> None:
        """Nothing where the table stands there already; else turns, notes it in the log, lets it settle."""
        if angle == self._angle:
            return
        if not math.isnan(self._angle):
            self._stream.table(self._angle, moving=True)
        self._table.turn_to(angle)
        self._angle = angle
        self._stream.table(angle, moving=False)
        self._stream.measure(self._settle)

    def _measure(self, duration: float, *, count: bool = True) -> tuple[Array, Array, Array]:
        """t (N,) s, gyro (N, 3) rad/s and accel (N, 3) m/s², calibrated."""
        if count:
            self._done += 1
            degrees = math.degrees(self._angle) % 360
            _say(f"stop {self._done}, at {degrees:.1f}°: {duration:.0f} s; do not touch the table")
        samples = self._stream.measure(duration)
        known = {} if self._calibration is None else self._calibration.nodes
        node = known.get(self._stream.node or "", NodeCalibration())
        # Neither age nor temperature: they move the bias, which turning about takes out here; the log that is
        # read in the end has both.
        gyro, accel = SampleCorrection.from_calibration(node).apply(samples.gyro, samples.accel)
        return samples.t, gyro, accel


@contextlib.contextmanager
def _table(port: str | None) -> Iterator[Turntable]:
    """The table on a serial port, asked once whether it is one; or one that is turned by hand."""
    if port is None:
        yield HandTable(_ask)
        return
    try:
        line = serial.Serial(port, _TABLE_BAUD, timeout=_TABLE_ANSWER_S, exclusive=True)
    except (OSError, ValueError) as error:
        raise LinkError(f"--table {port}: {error}; check the port and who else has it open") from error
    with line:
        table = SerialTable(line)
        line.timeout = TABLE_HELLO_S
        table.angle()
        line.timeout = _TABLE_ANSWER_S
        yield table


def _ask(line: str) -> str:
    """Asks on stderr, as stdout is for the result."""
    print(line, end="", file=sys.stderr, flush=True)
    return input()


def _say(line: str) -> None:
    print(line, file=sys.stderr)
