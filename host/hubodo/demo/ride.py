"""A ride: power on virtual nodes, let the real daemon record them over their serial ports."""

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

from hubodo.emulator.board.settings import BoardSettings, Clock, Flash, Host, SensorBoard
from hubodo.emulator.chips.imu import Specimen
from hubodo.emulator.interpreters.find import InterpreterMissing
from hubodo.emulator.interpreters.interpreter import Kind, require
from hubodo.emulator.interpreters.rp2040.pico import PicoSettings
from hubodo.emulator.node_motion import NodeMotion, Scatter
from hubodo.emulator.virtual_node import VirtualNode
from hubodo.errors import HubodoError
from hubodo.flash.image import build, firmware_folder, sources
from hubowire.messages import NODE_IDS

INTERPRETERS: dict[Kind, str] = {
    "micropython": "MicroPython",
    "cpython": "CPython",
    "rp2040": "MicroPython on an emulated RP2040",
}

RATE_HZ = 416
SETTLE = 4.0
"""s between power-on and the drive: a node boots in one or two, the daemon looks for ports every second."""
_TAIL = 1.0
_PATIENCE = 60.0
_POWER_ON, _BOOT, _HURRY, _LATE = 1.0, 0.8, 1.5, 0.05
_PICO = PicoSettings()
_PACE: dict[Kind, float] = {"micropython": 1.0, "cpython": 1.0, "rp2040": 2.0}
"""Seconds of the wall clock for one of the nodes, where each has a core of its own."""


@dataclass(frozen=True)
class Rider:
    """One node of a ride: what it feels, what its chip adds, how far its clocks are off."""

    motion: NodeMotion
    scatter: Scatter
    odr_error: float = 0.0
    clock_ppm: float = 0.0


@dataclass(frozen=True)
class RideResult:
    """What a ride left behind.

    start_ns: of the drive, on the clock of the log; recorded: the daemon's own words; pace: s of the wall
    clock for one of the ride.
    """

    log: Path
    vehicle: Path
    start_ns: int
    recorded: dict[str, Any]
    nodes: dict[str, dict[str, Any]]
    pace: float


def add_board_arguments(parser: argparse.ArgumentParser, of: str) -> None:
    """The options that say what runs the firmware; `of`: said in their help."""
    choices = ["auto", *INTERPRETERS]
    parser.add_argument(
        "--on",
        "--interpreter",
        dest="interpreter",
        choices=choices,
        default="auto",
        help=f"what runs the firmware{of}; rp2040: a whole emulated Pico, slower than real time",
    )
    parser.add_argument("--image", type=Path, help="with --on rp2040: MicroPython for the Pico, .uf2 or .bin")
    parser.add_argument("--bootrom", type=Path, help="with --on rp2040: of the chip (default: beside it)")


def choose_interpreter(wanted: str, image: Path | None = None, bootrom: Path | None = None) -> Kind:
    """What runs the firmware: as wanted, or with `auto` `micropython` if it is installed, else `cpython`.

    image, bootrom: of an emulated Pico. Says so on stderr where `auto` has to do without. Raises
    InterpreterMissing or ImageMissing where what is wanted is not there.
    """
    if wanted == "rp2040":
        require("rp2040", image, bootrom)
        return "rp2040"
    if wanted == "cpython":
        return "cpython"
    try:
        require("micropython")
    except InterpreterMissing as error:
        if wanted == "micropython":
            raise
        print(f"{error}; the same firmware files run on CPython instead", file=sys.stderr)
        return "cpython"
    return "micropython"


def write_image(folder: Path, interpreter: Kind) -> Path:
    """The firmware as it is flashed; CPython, which cannot run MicroPython's bytecode, gets the sources."""
    if interpreter == "cpython":
        image = sources(firmware_folder())
    else:
        image = build(firmware_folder(), "armv6m" if interpreter == "rp2040" else None)
    for name, content in image.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    return folder


def ride(
    riders: Mapping[str, Rider],
    vehicle_toml: str,
    out: Path,
    interpreter: Kind,
    seed: int,
    tick: Callable[[float], None],
    rate_hz: int = RATE_HZ,
    pico: PicoSettings = _PICO,
) -> RideResult:
    """Runs the drive in real time; `tick` gets the share done, 0 to 1, some times a second.

    What cannot keep up with real time runs slower, and the daemon's clock with it. riders: by node name, one
    of `hubowire.messages.NODE_IDS`; their drive begins SETTLE s after power-on. Raises HubodoError when the
    daemon or a node fails.
    """
    pace = _pace(interpreter, len(riders))
    firmware = write_image(out / "firmware", interpreter)
    vehicle, log = out / "vehicle.toml", out / "drive.mcap"
    vehicle.write_text(vehicle_toml, "utf-8")
    links = {name: out / f"tty-{name}" for name in riders}
    duration = max(rider.motion.duration for rider in riders.values()) + _TAIL
    with ExitStack() as stack:
        # The daemon first: on a busy computer it takes longer to start than a node does to boot.
        zero_ns = time.time_ns()
        daemon = stack.enter_context(_Daemon(links, log, vehicle, pace, zero_ns))
        # The boards need about as long as the daemon did.
        power_on_ns = time.monotonic_ns() + int(1e9 * (_POWER_ON + daemon.took))
        clock = Clock("paced", pace=pace, power_on_ns=power_on_ns)
        nodes = {}
        for name, rider in riders.items():
            flash = Flash(firmware, {"node_id": NODE_IDS[name], "rate_hz": rate_hz})
            board = BoardSettings(interpreter=interpreter, pico=pico, unique_id=_serial(seed, name))
            node = _node(rider, flash, board, clock, out / f"board-{name}", seed * 2 + NODE_IDS[name])
            nodes[name] = stack.enter_context(node)
        powered_ns = time.time_ns() + (power_on_ns - time.monotonic_ns())
        start_ns = zero_ns + int((powered_ns - zero_ns) / pace) + int(SETTLE * 1e9)

        def gone() -> float:
            return 1e-9 * (time.monotonic_ns() - power_on_ns) / pace

        _plug_in(nodes, links, gone, pace)
        while (now := gone()) < duration and daemon.running:
            tick(min(max(now / duration, 0.0), 1.0))
            time.sleep(0.2)
        recorded = daemon.stop()
        stats = {name: dict(node.stats) for name, node in nodes.items()}
    silent = [name for name in riders if name not in recorded["nodes"]]
    if silent:
        raise HubodoError(f"{silent[0]}: nothing arrived from this virtual node; run it again with less load")
    return RideResult(log, vehicle, start_ns, recorded, stats, pace)


def _node(
    rider: Rider, flash: Flash, board: BoardSettings, clock: Clock, port: Path, seed: int
) -> VirtualNode:
    return VirtualNode(
        rider.motion,
        flash,
        sensors=SensorBoard(specimen=Specimen(rider.odr_error, disturbance=rider.scatter)),
        board=board,
        clock=replace(clock, ppm=rider.clock_ppm),
        host=Host(path=port),
        seed=seed,
    )


def _serial(seed: int, name: str) -> str:
    """Unique id of a board, in hexadecimal."""
    return f"e66141{seed % 256:02x}000000{NODE_IDS[name]:02x}"


def speed_of(interpreter: Kind, nodes: int) -> str:
    """How fast a ride goes, in words."""
    pace = _pace(interpreter, nodes)
    return "in real time" if pace == 1.0 else f"at {1 / pace:.2f} of real time"


def _pace(interpreter: Kind, nodes: int) -> float:
    """Emulated boards share the cores with the daemon and each other."""
    alone = _PACE[interpreter]
    return alone if alone == 1.0 else alone * max(1.0, (nodes + 1) / (os.cpu_count() or 1))


def _plug_in(
    nodes: Mapping[str, VirtualNode], links: Mapping[str, Path], gone: Callable[[], float], pace: float
) -> None:
    """Connect the boards once they keep up with the wall clock.

    A board that boots on a busy computer is late and makes up for it in a rush, which no real clock does.
    """

    def late(node: VirtualNode) -> float:
        return gone() - float(node.stats["t"])

    time.sleep(pace * max(0.0, _BOOT - gone()))
    end = gone() + _HURRY
    while any(late(node) > _LATE for node in nodes.values()) and gone() < end:
        time.sleep(0.05)
    for name, node in nodes.items():
        links[name].symlink_to(node.link_path)


class _Daemon:
    """`hubodo record` in a process of its own; ready once its log is there, which took `took` s."""

    def __init__(
        self, links: Mapping[str, Path], log: Path, vehicle: Path, time_scale: float, time_zero_ns: int
    ) -> None:
        ports = [f"{name}={link}" for name, link in links.items()]
        words = [sys.executable, "-m", "hubodo.cli", "record", *ports, "-o", str(log)]
        words += ["--vehicle", str(vehicle), "--wait", "--json"]
        words += ["--time-scale", str(time_scale), "--time-zero", str(time_zero_ns)]
        self._log, self.took = log, 0.0
        self._process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def __enter__(self) -> Self:
        begin = time.monotonic()
        while self.running and not self._log.exists() and time.monotonic() < begin + _PATIENCE:
            time.sleep(0.05)
        self.took = time.monotonic() - begin
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait()

    @property
    def running(self) -> bool:
        return self._process.poll() is None

    def stop(self) -> dict[str, Any]:
        """Its account of what it recorded. Raises HubodoError with its complaint when it failed."""
        if self.running:
            self._process.send_signal(signal.SIGINT)
        try:
            said, complaint = self._process.communicate(timeout=_PATIENCE)
        except subprocess.TimeoutExpired:
            raise HubodoError(f"hubodo record did not end within {_PATIENCE:.0f} s; run it again") from None
        if self._process.returncode != 0:
            raise HubodoError(f"hubodo record failed: {complaint.strip() or 'it said nothing'}")
        found: dict[str, Any] = json.loads(said)
        return found
