"""The recordings that are replayed, and the references of their odometry.

Update after a change that intentionally changes the results:

    python tests/replay/update.py
"""

from __future__ import annotations

import hashlib
import json
import math
import platform
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import wanted
from generators.fake_drive import RADIUS, TRACK, short_drive
from hubodo.calibration.file import CalibratedEffect, Calibration, NodeCalibration, Quantity
from hubodo.ingest.replay.playback import Playback, to_messages
from hubodo.log.csv_folder import read_folder
from hubodo.log.recording_writer import write_recording
from hubodo.recording import Recording, Table
from hubodo.vehicle import NodeMount, Vehicle

REFERENCES = Path(__file__).with_name("references.json")
UPDATE = "python tests/replay/update.py"
TOLERANCE = 0.0
"""On the arithmetic that the references were made with: same rounding, Python and numpy."""
TOLERANCE_ELSEWHERE = 1e-6
"""m, rad: by how much a recording may differ on another processor.

Its fused operations and LAPACK kernels round each of some hundred filter steps differently, by 1e-16, and
gains of a poorly known state magnify that by up to 1e8.
"""
IGNORED = ("log time", "sequence number")
"""Of a message: they say when it was written, not what was found."""

TWO_WHEELS = Vehicle(RADIUS, TRACK, {name: NodeMount(name, "left") for name in ("left", "right")})
WHEELCHAIR = Vehicle(0.31, 0.92, {name: NodeMount(name, "left") for name in ("left", "right")})


@dataclass(frozen=True)
class Replay:
    """A recording, its source and the options of its playback. outputs: topics compared."""

    name: str
    recording: Callable[[], Recording]
    vehicle: Vehicle
    calibration: Calibration | None = None
    outputs: tuple[str, ...] = ("/odom", "/tf")


def _generated(seed: int, *names: str, rate_hz: float = 104.0) -> Callable[[], Recording]:
    def read() -> Recording:
        columns = ("t", "gx", "gy", "gz", "ax", "ay", "az")
        nodes = {}
        for name, node in short_drive(seed, rate_hz).nodes.items():
            if name in names:
                # A log stores whole nanoseconds.
                t = np.round(node.t + 1.0, 9)
                rows = np.column_stack([t, node.gyro, node.accel])
                nodes[name] = Table(dict(zip(columns, rows.T, strict=True)))
        return Recording(nodes)

    return read


def _wheelchair() -> Recording:
    return read_folder(wanted.recording("wheelchair"))


_CALIBRATION = Calibration(
    {
        "left": NodeCalibration(
            {
                "gyro_bias": CalibratedEffect({"x": Quantity(0.01, 1e-3), "z": Quantity(-0.005, 1e-3)}),
                "gyro_warmup": CalibratedEffect(
                    {"z": Quantity(0.002, 1e-3), "time_constant": Quantity(90.0, 9.0)}
                ),
                "gyro_scale_factor": CalibratedEffect({"z": Quantity(0.004, 1e-3)}),
                "node_misalignment": CalibratedEffect(
                    {"x": Quantity(0.01, 1e-3), "y": Quantity(-0.02, 1e-3)}
                ),
            }
        )
    }
)

TABLE = (
    Replay("two wheels", _generated(1, "left", "right"), TWO_WHEELS),
    Replay("one wheel of a vehicle with two", _generated(2, "right"), TWO_WHEELS),
    Replay("416 Hz", _generated(3, "left", "right", rate_hz=416.0), TWO_WHEELS),
    Replay("calibrated", _generated(4, "left", "right"), TWO_WHEELS, _CALIBRATION),
    Replay("wheelchair", _wheelchair, WHEELCHAIR),
)


def arithmetic() -> str:
    """Return a description of the versions and the rounding on which the last bits of a result depend.

    Processors of one instruction set may round differently, as BLAS and the C library choose kernels by
    model: the description contains the bits of some functions, products and solutions of typical sizes.
    """
    x = np.sin(np.arange(1.0, 1297.0)).reshape(36, 36)
    digest = hashlib.sha256()
    for size in (2, 3, 6, 9, 15, 36):
        block = x[:size, :size]
        normal = block @ block.T + np.eye(size)
        for part in (
            *(normal, np.linalg.solve(normal, block), np.linalg.cholesky(normal), np.linalg.inv(normal)),
            *(np.exp(block), np.arctan2(block, normal), np.einsum("ij,kj->ik", block, normal)),
        ):
            digest.update(part.tobytes())
    scalars = [f(value) for value in x[0] for f in (math.sin, math.cos, math.exp, math.atan)]
    digest.update(np.array(scalars).tobytes())
    versions = f"python {platform.python_version()} numpy {np.__version__}"
    return f"{platform.machine()} {versions} rounding {digest.hexdigest()[:16]}"


def play(replay: Replay, folder: Path) -> dict[str, list[tuple[int, bytes]]]:
    """Write the recording to a log and play it; return (publish time, bytes) by topic."""
    log = folder / "replay.mcap"
    write_recording(replay.recording(), log)
    playback = Playback(log, vehicle=replay.vehicle, calibration=replay.calibration)
    messages = to_messages(playback.odometry_rows(), playback.t_zero_ns)
    state = playback.odometer.state
    messages["end"] = [
        (0, json.dumps([state.x, state.y, state.heading, playback.odometer.distance]).encode())
    ]
    return messages


def reference(replay: Replay, messages: dict[str, list[tuple[int, bytes]]]) -> dict[str, object]:
    """Return the stored values: per topic the count and a hash over times and bytes; the end of the drive."""
    stored: dict[str, object] = {}
    for topic in replay.outputs:
        digest = hashlib.sha256()
        for t_ns, data in messages[topic]:
            digest.update(t_ns.to_bytes(8, "little") + data)
        stored[topic] = {"messages": len(messages[topic]), "sha256": digest.hexdigest()}
    stored["x, y, heading, distance"] = json.loads(messages["end"][0][1])
    return stored
