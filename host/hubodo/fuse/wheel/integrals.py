"""Integrands over the samples of a node, and windows as differences of their integrals."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel.window import WINDOW_S, Window

# Rows of the integrands: gz; real and imaginary parts of the terms rotated by the carrier (gyros across the
# axle W, one E, force F, gz S, gz² Q); terms that are not rotated; squares; and saturation flags.
GZ, WR, WI, ER, EI, FR, FI, AZ, GX, GY, AX, AY = range(12)
GG, ZZ, SR, SI, QR, QI, CS, CA, CF, CZ = range(12, 22)
MISSING = CZ + 1
"""Row of the time without samples. Behind it are gz and both parts of gx + i gy at the edges."""
SAMPLE_ROWS = (GZ, GX, GY, AX, AY)
"""Rows that `WindowSamples` are built from."""
_ROTATED_REAL_ROWS, _ROTATED_IMAGINARY_ROWS = (WR, ER, FR, SR, QR), (WI, EI, FI, SI, QI)
"""Real and imaginary parts of the rotated terms."""


def integrands(
    gyro: Array, accel: Array, angle: Array, sign: float, limits: tuple[float, float], beyond_range: Array
) -> Array:
    """Return the integrands of samples, (CZ + 1, N).

    gyro: (N, 3) rad/s and accel: (N, 3) m/s², node axes; sign: -1.0 for a node facing right. angle: (N,)
    rad, carrier. limits: rad/s and m/s² from which on a sample counts as clipped. beyond_range: (N,) 1 where
    accel is not clipped at any value.
    """
    gx, gy, gz = gyro[:, 0], sign * gyro[:, 1], sign * gyro[:, 2]
    ax, ay, az = accel[:, 0], sign * accel[:, 1], sign * accel[:, 2]
    cos, sin = cosine_and_sine(angle)
    rows = np.empty((CZ + 1, len(angle)))
    rows[GZ], rows[AZ] = gz, az
    rows[GX], rows[GY], rows[AX], rows[AY] = gx, gy, ax, ay
    rows[WR], rows[WI] = gx * cos - gy * sin, gx * sin + gy * cos
    rows[ER], rows[EI] = cos, sin
    rows[FR], rows[FI] = ax * cos - ay * sin, ax * sin + ay * cos
    rows[GG], rows[ZZ] = gx * gx + gy * gy + gz * gz, az * az
    rows[SR], rows[SI] = gz * cos, gz * sin
    rows[QR], rows[QI] = gz * rows[SR], gz * rows[SI]
    clipped, force_clipped = np.abs(gyro) >= limits[0], np.abs(accel) >= limits[1]
    force_clipped &= (beyond_range == 0.0)[:, None]
    rows[CS], rows[CA] = clipped[:, 2], clipped[:, 0] | clipped[:, 1]
    rows[CF], rows[CZ] = force_clipped[:, 0] | force_clipped[:, 1], force_clipped[:, 2]
    return rows


def build_windows(first: int, edge_values: Array) -> list[Window]:
    """Return the windows from number `first` on between consecutive edges.

    edge_values: (CZ + 5, N) integrals, time without samples, gz and gx + i gy at the edges.
    """
    d = edge_values[:, 1:] - edge_values[:, :-1]
    count = d.shape[1]
    if not count:
        return []
    middle = 0.5 * (edge_values[GZ, 1:] + edge_values[GZ, :-1])
    rate_start, rate_end = edge_values[MISSING + 1, :-1], edge_values[MISSING + 1, 1:]
    across_at_edge = edge_values[-2] + 1j * edge_values[-1]
    rotation_back = np.exp(-1j * middle)
    rotated = _rotate_back(d, *cosine_and_sine(middle))
    change = ((rate_end - rate_start) / WINDOW_S).tolist()
    mean = d / WINDOW_S
    gyro_variance = mean[GG] - (mean[GX] ** 2 + mean[GY] ** 2 + mean[GZ] ** 2)
    axial_variance = mean[ZZ] - mean[AZ] * mean[AZ]
    columns: dict[str, Iterable[Any]] = {
        "number": range(first, first + count),
        "spin": d[GZ].tolist(),
        "rate_start": rate_start.tolist(),
        "rate_end": rate_end.tolist(),
        "across": rotated[WR],
        "carrier": rotated[ER],
        "force": rotated[FR],
        "axial": d[AZ].tolist(),
        "raw_across": _complex(d[GX], d[GY]),
        "raw_force": _complex(d[AX], d[AY]),
        "gyro_variance": np.maximum(gyro_variance, 0.0).tolist(),
        "axial_variance": np.maximum(axial_variance, 0.0).tolist(),
        "spin_clipped": mean[CS].tolist(),
        "across_clipped": mean[CA].tolist(),
        "force_clipped": mean[CF].tolist(),
        "axial_clipped": mean[CZ].tolist(),
        "missing": mean[MISSING].tolist(),
        "clock_angle": middle.tolist(),
        "across_change": ((across_at_edge[1:] - across_at_edge[:-1]) * rotation_back).tolist(),
        "rate_carrier": rotated[SR],
        "samples": [None] * count,
        "gravity_angle": [None] * count,
        "blind_windows": [0] * count,
        "beyond_range": [0.0] * count,
        "lever": [1j * a * c - q for a, c, q in zip(change, rotated[ER], rotated[QR], strict=True)],
    }
    rows = zip(*(columns[name] for name in Window._fields), strict=True)
    return [Window._make(row) for row in rows]


def _rotate_back(d: Array, cos: Array, sin: Array) -> dict[int, list[complex]]:
    """Return the rotated pairs of rows times e^(-i middle), keyed by their first row.

    Angles then count from the middle of the window.
    """
    real, imaginary = d[_ROTATED_REAL_ROWS, :], d[_ROTATED_IMAGINARY_ROWS, :]
    pairs = _complex(real * cos + imaginary * sin, imaginary * cos - real * sin)
    return dict(zip(_ROTATED_REAL_ROWS, pairs, strict=True))


def _complex(real: Array, imaginary: Array) -> list[Any]:
    pair = np.empty(real.shape, complex)
    pair.real, pair.imag = real, imaginary
    return list(pair.tolist())


def cosine_and_sine(angle: Array) -> tuple[Array, Array]:
    """Return cosine and sine of angles (N,), rad, computed angle by angle.

    The result is then bit-identical however samples are split into blocks; numpy may process the ends of an
    array with other instructions than its middle, which changes the last bit.
    """
    values = angle.tolist()
    cosine = np.fromiter(map(math.cos, values), np.float64, len(values))
    return cosine, np.fromiter(map(math.sin, values), np.float64, len(values))
