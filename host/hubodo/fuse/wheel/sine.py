"""Sine and cosine from additions and products alone, so that one sample and a million give the same bits."""

from __future__ import annotations

import math

import numpy as np

from hubodo.arrays import Array

_TURN = 2.0 * math.pi
_SINE = tuple((-1.0) ** k / math.factorial(2 * k + 1) for k in range(14))
_COSINE = tuple((-1.0) ** k / math.factorial(2 * k) for k in range(15))


def cosine_and_sine(angle: Array) -> tuple[Array, Array]:
    """cos and sin of angles, (N,) rad, to 1e-14 within one turn.

    numpy's own may treat the ends of an array by other instructions than its middle; the last bit would then
    depend on the portions in which samples come. Taylor series to the 28th power within half a turn of zero.
    """
    x = angle - _TURN * np.floor(angle * (1.0 / _TURN) + 0.5)
    square = x * x
    cosine, sine = np.full_like(x, _COSINE[-1]), np.full_like(x, _SINE[-1])
    for coefficient in _COSINE[-2::-1]:
        cosine *= square
        cosine += coefficient
    for coefficient in _SINE[-2::-1]:
        sine *= square
        sine += coefficient
    sine *= x
    return cosine, sine
