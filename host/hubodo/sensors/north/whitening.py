"""Averages of a drifting gyro made white: the drift's covariance taken out, its bias and its ramp too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.linalg import cholesky
from scipy.linalg.lapack import dtrtri

from hubodo.arrays import Array
from hubodo.sensors.north.averages import Averages
from hubodo.sensors.north.drift import flicker, quantization, random_walk

PIECE = 300
"""Intervals solved together; longer records are cut into pieces with a bias and a ramp each.

That costs little: the drift of one piece says next to nothing about Earth rate in another.
"""
RAMP, BEND = 1, 3
"""Order of the unknown polynomial of each piece: bias and ramp, or what a gyro does that warms up besides."""


Ratios = tuple[float, float, float]
"""B² T / N², K² T² / N² and Q² / (N² T) with T the mean interval."""


@dataclass(frozen=True)
class Sufficient:
    """What the likelihood needs of records.

    gram: (5, 5) inner products of the columns of `Averages`, white and free of bias and ramp, in units of
    N² / mean interval. logdet: log determinant of the restricted covariance; plain: of the whole one.
    """

    gram: Array
    logdet: float
    plain: float


def pieces_of(records: Sequence[Averages]) -> list[Averages]:
    """Records cut into pieces of at most PIECE averages."""
    made = []
    for record in (it for it in records if len(it.y)):
        count = -(-len(record.y) // PIECE)
        edges = np.linspace(0, len(record.y), count + 1).round().astype(int)
        made += [record.part(int(a), int(b)) for a, b in pairwise(edges)]
    return made


def sufficient(
    pieces: Sequence[Averages], grid: Sequence[Ratios], mean: float, scale: float = 0.0, order: int = RAMP
) -> list[Sufficient]:
    """Summed over the pieces, at each point of the grid.

    mean: s, of an interval. scale: error of the gyro's at which the angles are. order: of the polynomial.
    """
    # Same stops, same matrix: programmes repeat from record to record, so rounding makes them meet in the
    # cache.
    keys = [np.round(np.stack([p.start, p.end]) - p.start[0], 4).tobytes() for p in pieces]
    columns = [piece.columns(scale) for piece in pieces]
    unit = round(mean, 4)
    made = []
    for ratios in grid:
        gram: Array = np.zeros((5, 5))
        logdet = plain = 0.0
        for key, seen in zip(keys, columns, strict=True):
            whitener, nuisance, restricted, whole = _whitener(key, ratios, unit, order)
            white = whitener @ seen
            white = white - nuisance @ (nuisance.T @ white)
            gram, logdet, plain = gram + white.T @ white, logdet + restricted, plain + whole
        made.append(Sufficient(gram, logdet, plain))
    return made


@lru_cache(maxsize=160)
def _whitener(key: bytes, ratios: Ratios, unit: float, order: int) -> tuple[Array, Array, float, float]:
    """Inverse Cholesky factor (M, M), orthonormal polynomial behind it (M, order + 1), log determinants.

    key: start and end, float64. Of the covariance in units of N² / unit: restricted to what the polynomial
    cannot explain, and whole.
    """
    start, end = np.frombuffer(key).reshape(2, -1)
    f, w, q = ratios
    matrix = np.diag(unit / (end - start)) + w / unit * random_walk(start, end)
    if f:
        matrix = matrix + f * _flicker(key)
    if q:
        matrix = matrix + q * unit**2 * quantization(start, end)
    factor = cholesky(matrix, lower=True, check_finite=False)
    inverse = dtrtri(factor, lower=1)[0]
    middle = (start + end) / 2
    ramp = (middle - middle.mean()) / max(float(np.ptp(middle)), 1e-9)
    behind, r = np.linalg.qr(inverse @ legvander(2 * ramp, order))
    whole = 2 * float(np.log(np.diag(factor)).sum())
    restricted = whole + 2 * float(np.log(np.abs(np.diag(r))).sum())
    return np.asarray(inverse), np.asarray(behind), restricted, whole


@lru_cache(maxsize=8)
def _flicker(key: bytes) -> Array:
    return flicker(*np.frombuffer(key).reshape(2, -1))
