"""Cosine and sine computed angle by angle, so that one sample and a million give the same bits."""

from __future__ import annotations

import math

import numpy as np

from hubodo.arrays import Array


def cosine_and_sine(angle: Array) -> tuple[Array, Array]:
    """Return cosine and sine of angles (N,), rad.

    numpy may treat the ends of an array with other instructions than its middle; the last bit would then
    depend on how samples are split into blocks.
    """
    values = angle.tolist()
    cosine = np.fromiter(map(math.cos, values), np.float64, len(values))
    return cosine, np.fromiter(map(math.sin, values), np.float64, len(values))
