"""One demo ride: power on two virtual nodes, let the real daemon record them over their serial ports."""

import json
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from hubodo.demo.scenario import SIDES, VEHICLE_TOML, Scenario
from hubodo.errors import HubodoError
from hubodo.flash.image import build, firmware_folder, sources
from hubodo.model.virtual_node import VirtualNode
from hubowire.messages import NODE_IDS

Interpreter = Literal["micropython", "cpython"]

RATE_HZ = 416
# Between power-on and the drive: a node needs about a second to boot, the daemon to open its ports.
_SETTLE = 3.0
_TAIL = 1.0
# By then both boards' processes have started.
_POWER_ON_NS = 2_000_000_000


@dataclass(frozen=True)
class RideResult:
    """What a ride left behind. start_ns: host time of the drive's start; recorded: the daemon's own words."""

    log: Path
    vehicle: Path
    start_ns: int
    recorded: dict[str, Any]
    nodes: dict[str, dict[str, Any]]


def write_image(folder: Path, interpreter: Interpreter) -> Path:
    """The firmware as it is flashed; CPython, which cannot run MicroPython's bytecode, gets the sources."""
    image = build(firmware_folder(), None) if interpreter == "micropython" else sources(firmware_folder())
    for name, content in image.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    return folder


def ride(
    scenario: Scenario, out: Path, interpreter: Interpreter, tick: Callable[[float], None]
) -> RideResult:
    """Runs the drive in real time; `tick` gets the share done, 0 to 1, some times a second.

    Raises HubodoError when the daemon or a node fails.
    """
    firmware = write_image(out / "firmware", interpreter)
    vehicle = out / "vehicle.toml"
    vehicle.write_text(VEHICLE_TOML, "utf-8")
    log = out / "drive.mcap"
    duration = _SETTLE + scenario.drive.duration + _TAIL
    with ExitStack() as stack:
        power_on_ns = time.monotonic_ns() + _POWER_ON_NS
        nodes = {}
        for side in SIDES:
            part = scenario.parts[side]
            node = VirtualNode(
                scenario.motion(side, _SETTLE),
                firmware=firmware,
                config={"node_id": NODE_IDS[side], "rate_hz": RATE_HZ},
                odr_error=part.odr_error,
                disturbance=part.errors,
                seed=scenario.seed * 2 + NODE_IDS[side],
                interpreter=interpreter,
                link_path=out / f"tty-{side}",
                clock_ppm=part.clock_ppm,
                unique_id=f"e66141{scenario.seed % 256:02x}000000{NODE_IDS[side]:02x}",
                clock="paced",
                power_on_ns=power_on_ns,
            )
            nodes[side] = stack.enter_context(node)
        start_ns = time.time_ns() + (power_on_ns - time.monotonic_ns()) + int(_SETTLE * 1e9)
        recorded = _record(
            [f"{side}={node.link_path}" for side, node in nodes.items()], log, vehicle, duration, tick
        )
        stats = {str(side): dict(node.stats) for side, node in nodes.items()}
    return RideResult(log, vehicle, start_ns, recorded, stats)


def _record(
    ports: list[str], log: Path, vehicle: Path, duration: float, tick: Callable[[float], None]
) -> dict[str, Any]:
    words = [sys.executable, "-m", "hubodo.cli", "record", *ports, "-o", str(log), "--vehicle", str(vehicle)]
    words += ["--duration", f"{duration:.1f}", "--json"]
    started = time.monotonic()
    daemon = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        while daemon.poll() is None:
            tick(min((time.monotonic() - started) / duration, 1.0))
            time.sleep(0.2)
        said, complaint = daemon.communicate()
    finally:
        daemon.kill()
    if daemon.returncode != 0:
        raise HubodoError(f"hubodo record failed: {complaint.strip() or 'it said nothing'}")
    found: dict[str, Any] = json.loads(said)
    return found
