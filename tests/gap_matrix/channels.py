"""Readings of a node by channel, on the even grid of the ideal readings and at its sample times."""

from __future__ import annotations

import numpy as np

from gap_matrix import sensor
from gap_matrix.world import Array, IdealReadings

CHANNELS = ("gx", "gy", "gz", "ax", "ay", "az")


def interpolate(ideal: IdealReadings, sample_times: Array, *rows: Array) -> Array:
    """Return rows of the even 1 kHz grid at the sample times."""
    return sensor.interpolate_cubic(np.vstack(rows), ideal.motion.step, sample_times)


def stack_channels(**channels: Array) -> Array:
    """Return (n, 6) readings with zeros on the channels that are not given."""
    first = next(iter(channels.values()))
    return np.stack([channels.get(name, np.zeros(len(first))) for name in CHANNELS], 1)


def facing_sign(ideal: IdealReadings) -> float:
    """Return +1 if the z axis points left, from gravity: f_y = -facing g sin(angle)."""
    return float(-np.sign(np.sum(ideal.force[1] * np.sin(ideal.angle))))
