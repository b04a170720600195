"""Drives of a node on a rim with a second accelerometer of 200 g, generated without the model under test.

The drive is generated with a range of 200 g. The record of the IMU is that, clipped at 16 g. The second chip
is sampled at its own times and has what the data sheet of an ADXL375 allows: scale, tilt, offset, noise of
5 mg/√Hz, and steps of 49 mg; in addition it sits beside the IMU.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from generators.clipped_drives import Clipped, clipped_drive
from generators.wheel_drives import ACCEL_STEP, GRAVITY, Ends, Errors, WheelDrive, drive, ramps
from hubodo.recording import Recording, Table
from wheel_runs import tables

IMU_RANGE = 2**15 * ACCEL_STEP
CHIP_STEP = 0.049 * GRAVITY


@dataclass(frozen=True)
class ChipErrors:
    """1 sigma of the errors drawn for each chip.

    scale: relative, of each axis. tilt: rad. offset: m/s². density: m/s²/√Hz. delay: s of all its time
    stamps. shift: m between the chips, in each direction.
    """

    scale: float = 0.05
    tilt: float = 0.03
    offset: float = 0.4 * GRAVITY
    density: float = 5e-3 * GRAVITY
    delay: float = 0.5e-3
    shift: float = 0.003


@dataclass(frozen=True)
class RimDrive:
    """A drive with its tables by node.

    chips: second accelerometers. wide: (N, 3) m/s², what an IMU without limits would record.
    """

    drive: WheelDrive
    chips: dict[str, Table]
    wide: dict[str, np.ndarray]
    nodes: dict[str, Table]

    @property
    def recording(self) -> Recording:
        """Return all tables as a recording."""
        return Recording(self.nodes, high_g=self.chips)


WIDE = Ends(np.radians(2000.0), 200.0 * GRAVITY)
ARM = 0.15
"""m from the axle."""


def rim_drive(speed: float, angle: float, seed: int, **options: Any) -> RimDrive:
    """Return a drive up to `speed`, m/s, with nodes at `angle`, rad, in their axes; options: `add_chips`."""
    arm = ARM * np.cos(angle), ARM * np.sin(angle)
    slow_to_fast = clipped_drive(Clipped(speed, ends=WIDE, rate_hz=416.0, arm=arm), seed)
    return add_chips(slow_to_fast, seed, **options)


def short_rim_drive(seed: int) -> RimDrive:
    """Return a drive that accelerates to 14 m/s within 5 s, with nodes at 45 degrees."""
    plan = ramps([(1.0, 0.0, 0.0), (7.0, 14.0, 0.1)], 3.0)
    arm = ARM * np.sqrt(0.5), ARM * np.sqrt(0.5)
    rng = np.random.default_rng(seed)
    return add_chips(drive(plan, rng, Errors(bumps=1.0), 0.3, 0.6, rate_hz=416.0, arm=arm, ends=WIDE), seed)


def add_chips(
    wide: WheelDrive, seed: int, errors: ChipErrors | None = None, rate_hz: float = 400.0
) -> RimDrive:
    """Return a drive of an IMU of 200 g as one of 16 g and a second accelerometer record it."""
    errors = errors or ChipErrors()
    rng = np.random.default_rng([seed, 375])
    nodes, chips = {}, {}
    for name, node in wide.nodes.items():
        nodes[name] = replace(node, accel=np.clip(node.accel, -IMU_RANGE, IMU_RANGE - ACCEL_STEP))
        spin = np.interp(node.t, wide.t, wide.speed) / wide.radius
        force = node.accel.copy()
        # Centripetal force on the distance between the chips.
        force[:, :2] -= (spin**2)[:, None] * errors.shift * rng.standard_normal(2)
        period = 1.0 / rate_hz * (1.0 + 0.01 * rng.standard_normal())
        t = np.arange(node.t[0] + 0.05, node.t[-1] - 0.05, period)
        true_t = t + errors.delay * rng.standard_normal()
        measured = np.column_stack([np.interp(true_t, node.t, axis) for axis in force.T])
        matrix = np.diag(1.0 + errors.scale * rng.standard_normal(3))
        matrix += errors.tilt * rng.standard_normal((3, 3)) * (1.0 - np.eye(3))
        noise = errors.density * np.sqrt(0.5 * rate_hz) * rng.standard_normal((len(t), 3))
        measured = measured @ matrix.T + errors.offset * rng.standard_normal(3) + noise
        measured = np.round(measured / CHIP_STEP) * CHIP_STEP
        chips[name] = Table(dict(zip(("t", "ax", "ay", "az"), [t, *measured.T], strict=True)))
    recorded = replace(wide, nodes=nodes)
    wide_accel = {name: node.accel for name, node in wide.nodes.items()}
    return RimDrive(recorded, chips, wide_accel, tables(recorded))
