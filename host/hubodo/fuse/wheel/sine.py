"""Sine and cosine angle by angle, so that one sample and a million give the same bits."""

from __future__ import annotations

import math

import numpy as np

from hubodo.arrays import Array


def cosine_and_sine(angle: Array) -> tuple[Array, Array]:
    """cos and sin of angles, (N,) rad.

    numpy's own may treat the ends of an array by other instructions than its middle; the last bit would then
    depend on the portions in which samples come.
    """
    values = angle.tolist()
    cosine = np.fromiter(map(math.cos, values), np.float64, len(values))
    return cosine, np.fromiter(map(math.sin, values), np.float64, len(values))
