"""A simulated drive: virtual nodes are powered on and recorded over their serial ports in virtual time."""

import argparse
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from hubodo.demo.attached_node import AttachedNode
from hubodo.emulator.board.settings import BoardSettings, Clock, Flash, Host, SensorBoard
from hubodo.emulator.chips.imu import Specimen
from hubodo.emulator.interpreters.find import InterpreterMissing
from hubodo.emulator.interpreters.interpreter import InterpreterKind, check_available
from hubodo.emulator.interpreters.rp2040.pico import PicoSettings
from hubodo.emulator.node_motion import NodeMotion, SensorDisturbance
from hubodo.emulator.virtual_node import VirtualNode
from hubodo.errors import HubodoError
from hubodo.flash.image import build_image, firmware_folder, read_sources
from hubodo.ingest.live.daemon import record
from hubodo.ingest.live.record_config import RecordConfig
from hubodo.ingest.live.virtual_computer import VirtualComputer
from hubodo.units import NS_PER_S
from hubodo.vehicle import load_vehicle
from hubodo.version import __version__
from hubowire import FINGERPRINT
from hubowire.messages import NODE_IDS

INTERPRETERS: dict[InterpreterKind, str] = {
    "micropython": "MicroPython",
    "cpython": "CPython",
    "rp2040": "MicroPython on an emulated RP2040",
}

RATE_HZ = 416
DRIVE_START_S = 4.0
"""Time in s between power-on and the start of the drive; a node boots in one to two seconds."""
_RECORDING_MARGIN_S = 1.0  # recorded after the end of the drive
_DEFAULT_PICO = PicoSettings()


@dataclass(frozen=True)
class SimulatedNode:
    """One node of a simulated drive.

    Attributes
    ----------
    motion
        True rates and specific forces of the node.
    disturbance
        Noise and time-varying errors of its sensor.
    odr_error
        Relative error of the sensor's output data rate.
    clock_ppm
        Error of the board's clock, ppm.
    """

    motion: NodeMotion
    disturbance: SensorDisturbance
    odr_error: float = 0.0
    clock_ppm: float = 0.0


@dataclass(frozen=True)
class SimulatedDrive:
    """The files and statistics of a simulated drive.

    Attributes
    ----------
    log, vehicle
        Paths of the log and of the vehicle file.
    start_ns
        Start of the drive on the clock of the log.
    recorded
        JSON result of the recorder.
    nodes
        Statistics of the virtual nodes, by name.
    """

    log: Path
    vehicle: Path
    start_ns: int
    recorded: dict[str, Any]
    nodes: dict[str, dict[str, Any]]


def add_board_arguments(parser: argparse.ArgumentParser, context: str) -> None:
    """Add the options that select what runs the firmware; `context` is appended to their help."""
    choices = ["auto", *INTERPRETERS]
    parser.add_argument(
        "--on",
        "--interpreter",
        dest="interpreter",
        choices=choices,
        default="auto",
        help=f"interpreter of the firmware{context}; rp2040: a complete emulated Pico, much slower",
    )
    parser.add_argument("--image", type=Path, help="with --on rp2040: MicroPython for the Pico, .uf2 or .bin")
    parser.add_argument(
        "--bootrom", type=Path, help="with --on rp2040: boot ROM of the chip (default: beside the image)"
    )


def choose_interpreter(
    requested: str, image: Path | None = None, bootrom: Path | None = None
) -> InterpreterKind:
    """Return the requested interpreter, or for `auto` MicroPython if installed, else CPython.

    image, bootrom: files of an emulated Pico. Prints a notice on stderr if `auto` uses CPython. Raises
    InterpreterMissing or ImageMissing if the requested one is not available.
    """
    if requested == "rp2040":
        check_available("rp2040", image, bootrom)
        return "rp2040"
    if requested == "cpython":
        return "cpython"
    try:
        check_available("micropython")
    except InterpreterMissing as error:
        if requested == "micropython":
            raise
        print(f"{error}; the same firmware files run on CPython instead", file=sys.stderr)
        return "cpython"
    return "micropython"


def write_image(folder: Path, interpreter: InterpreterKind) -> Path:
    """Write the firmware as it is flashed; CPython gets sources, as it cannot run MicroPython bytecode."""
    if interpreter == "cpython":
        image = read_sources(firmware_folder())
    else:
        image = build_image(firmware_folder(), "armv6m" if interpreter == "rp2040" else None)
    for name, content in image.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    return folder


def record_drive(
    simulated_nodes: Mapping[str, SimulatedNode],
    vehicle_toml: str,
    out: Path,
    interpreter: InterpreterKind,
    seed: int,
    report_progress: Callable[[float], None],
    rate_hz: int = RATE_HZ,
    pico: PicoSettings = _DEFAULT_PICO,
    start_ns: int | None = None,
) -> SimulatedDrive:
    """Simulate and record a drive as fast as the computer allows.

    simulated_nodes: by node name, one of `hubowire.messages.NODE_IDS`; the drive starts DRIVE_START_S after
    power-on. report_progress: gets the completed share, 0 to 1. start_ns: host time of power-on; None: now.
    Raises HubodoError if the recorder or a node fails.
    """
    firmware = write_image(out / "firmware", interpreter)
    vehicle, log = out / "vehicle.toml", out / "drive.mcap"
    vehicle.write_text(vehicle_toml, "utf-8")
    duration = max(rider.motion.duration for rider in simulated_nodes.values()) + _RECORDING_MARGIN_S
    ports = tuple(f"{name}={out / f'tty-{name}'}" for name in simulated_nodes)
    with ExitStack() as stack:
        computer = VirtualComputer(
            lambda t_ns: report_progress(min(1.0, (t_ns - zero_ns) / NS_PER_S / duration)),
            start_ns=time.time_ns() if start_ns is None else start_ns,
            folder=out,
        )
        zero_ns = computer.now_ns()
        nodes = {}
        for name, rider in simulated_nodes.items():
            flash = Flash(firmware, {"node_id": NODE_IDS[name], "rate_hz": rate_hz})
            board = BoardSettings(
                interpreter=interpreter,
                pico=pico,
                unique_id=_serial(seed, name),
                random_seed=2 * seed + NODE_IDS[name],
            )
            node = _make_node(rider, flash, board, out / f"tty-{name}", seed * 2 + NODE_IDS[name])
            nodes[name] = stack.enter_context(node)
            computer.plug_in(AttachedNode(node, computer))
        recorded = record(
            RecordConfig(ports=ports, duration=duration),
            log,
            vehicle=load_vehicle(vehicle),
            metadata={
                "hubodo": __version__,
                "fingerprint": f"{FINGERPRINT:08x}",
                "ports": " ".join(simulated_nodes),
            },
            attachments={"vehicle.toml": vehicle.read_bytes()},
            computer=computer,
            console=Console(quiet=True),
        )
        stats = {name: dict(node.stats) for name, node in nodes.items()}
    if recorded.duration < duration:
        raise KeyboardInterrupt
    silent = [name for name in simulated_nodes if name not in recorded.nodes]
    if silent:
        raise HubodoError(f"{silent[0]}: no data received from this virtual node")
    return SimulatedDrive(log, vehicle, zero_ns + int(DRIVE_START_S * NS_PER_S), recorded.as_json(), stats)


def _make_node(
    simulated_node: SimulatedNode, flash: Flash, board: BoardSettings, port: Path, seed: int
) -> VirtualNode:
    return VirtualNode(
        simulated_node.motion,
        flash,
        sensors=SensorBoard(
            specimen=Specimen(simulated_node.odr_error, disturbance=simulated_node.disturbance)
        ),
        board=board,
        clock=Clock("lockstep", ppm=simulated_node.clock_ppm),
        host=Host(path=port),
        seed=seed,
    )


def _serial(seed: int, name: str) -> str:
    """Return the unique id of a board in hexadecimal."""
    return f"e66141{seed % 256:02x}000000{NODE_IDS[name]:02x}"
