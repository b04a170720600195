"""White noise of the inertial sensors that a node reports, for the covariances of its samples."""

from __future__ import annotations

import math
from collections.abc import Mapping

from hubodo.earth import STANDARD_GRAVITY
from hubodo.ingest.node.chip_identities import imu_chip
from hubowire.messages import Hello, Part

# Noise densities of gyro and accelerometer from the data sheets: mdeg/s/√Hz and µg/√Hz.
_DENSITIES: Mapping[int, tuple[float, float]] = {
    Part.LSM6DS33: (7.0, 90.0),
    Part.MPU6050: (5.0, 400.0),
    Part.MPU6500: (10.0, 300.0),
}
_UNKNOWN_DENSITIES = (10.0, 400.0)
"""The larger values of the chips above: an unknown chip is not trusted more than a known one."""


def sample_noise(hello: Hello) -> tuple[float, float]:
    """Return the 1 sigma noise of one sample, rad/s and m/s², at the rate of the node.

    A sample at rate f of white noise with the one-sided density N of a data sheet has a standard deviation
    of N √(f/2).
    """
    gyro, accel = next(filter(None, map(_densities, hello.parts)), _UNKNOWN_DENSITIES)
    root_bandwidth = math.sqrt(hello.rate_mhz / 1000 / 2)
    return math.radians(gyro * 1e-3) * root_bandwidth, accel * 1e-6 * STANDARD_GRAVITY * root_bandwidth


def _densities(row: tuple[int, ...]) -> tuple[float, float] | None:
    """Return the noise densities of a chip on the bus; None unless it is a known IMU."""
    address, who_am_i, part = row
    chip = None if part else imu_chip(address, who_am_i)
    return _DENSITIES.get(part) if chip is None else (chip.gyro_density, chip.accel_density)
