"""Whitening of gyro averages by their drift covariance, with bias and ramp projected out."""

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
from hubodo.sensors.north.drift import flicker_covariance, quantisation_covariance, random_walk_covariance

MAX_PIECE_AVERAGES = 300
"""Largest number of averages solved jointly; longer records are cut into pieces with separate bias and ramp.

The loss is small, because the drift of one piece contains almost no information on Earth rate in another.
"""
RAMP_ORDER, BEND_ORDER = 1, 3
"""Order of the unknown polynomial of each piece: bias and ramp, or also the curvature of a warm-up."""


NoiseRatios = tuple[float, float, float]
"""Noise ratios B² T / N², K² T² / N² and Q² / (N² T), with T the mean interval."""


@dataclass(frozen=True)
class SufficientStatistics:
    """The sufficient statistics of the likelihood.

    Attributes:
        gram: (5, 5) inner products of the columns of `Averages`, whitened and without bias and ramp, in
            units of N² / mean interval.
        logdet, unrestricted_logdet: log determinant of the restricted and of the full covariance.
    """

    gram: Array
    logdet: float
    unrestricted_logdet: float


def split_pieces(records: Sequence[Averages]) -> list[Averages]:
    """Cut records into pieces of at most MAX_PIECE_AVERAGES averages."""
    results = []
    for record in (one for one in records if len(one.y)):
        count = -(-len(record.y) // MAX_PIECE_AVERAGES)
        edges = np.linspace(0, len(record.y), count + 1).round().astype(int)
        results += [record.slice_rows(int(a), int(b)) for a, b in pairwise(edges)]
    return results


def sufficient_statistics(
    pieces: Sequence[Averages],
    grid: Sequence[NoiseRatios],
    mean: float,
    scale: float = 0.0,
    order: int = RAMP_ORDER,
) -> list[SufficientStatistics]:
    """Return the sufficient statistics, summed over the pieces, at each point of the grid.

    Temperatures of the pieces, if present, are projected out like the polynomial.

    mean: mean interval, s. scale: scale error of the gyro at which angles are evaluated. order: order of the
    polynomial.
    """
    # Programmes repeat from record to record; with rounded times they share cached matrices.
    keys = [np.round(np.stack([p.start, p.end]) - p.start[0], 4).tobytes() for p in pieces]
    columns = [piece.design_columns(scale) for piece in pieces]
    temperatures = [temperature_column(piece).tobytes() for piece in pieces]
    unit = round(mean, 4)
    results = []
    for ratios in grid:
        gram: Array = np.zeros((5, 5))
        logdet = unrestricted = 0.0
        for key, data, warmth in zip(keys, columns, temperatures, strict=True):
            whitener, nuisance, restricted, full_logdet = _whitener(key, ratios, unit, order, warmth)
            white = whitener @ data
            white = white - nuisance @ (nuisance.T @ white)
            gram, logdet, unrestricted = (
                gram + white.T @ white,
                logdet + restricted,
                unrestricted + full_logdet,
            )
        results.append(SufficientStatistics(gram, logdet, unrestricted))
    return results


def temperature_column(piece: Averages) -> Array:
    """Return the temperature of a piece about its mean, relative to its range, (M, 1); (M, 0) without."""
    if piece.temperature is None:
        return np.zeros((len(piece.y), 0))
    change = piece.temperature - piece.temperature.mean()
    return np.asarray(change[:, None] / max(float(np.ptp(change)), 1e-9))


@lru_cache(maxsize=160)
def _whitener(
    key: bytes, ratios: NoiseRatios, unit: float, order: int, warmth: bytes
) -> tuple[Array, Array, float, float]:
    """Return the inverse Cholesky factor (M, M), the whitened orthonormal polynomial and log determinants.

    key: bytes of start and end, float64. warmth: bytes of `temperature_column`. The log determinants are
    those of the covariance in units of N² / unit, restricted to the complement of polynomial and temperature,
    and unrestricted.
    """
    start, end = np.frombuffer(key).reshape(2, -1)
    flicker_ratio, walk_ratio, quantisation_ratio = ratios
    matrix = np.diag(unit / (end - start)) + walk_ratio / unit * random_walk_covariance(start, end)
    if flicker_ratio:
        matrix = matrix + flicker_ratio * _flicker(key)
    if quantisation_ratio:
        matrix = matrix + quantisation_ratio * unit**2 * quantisation_covariance(start, end)
    factor = cholesky(matrix, lower=True, check_finite=False)
    inverse = dtrtri(factor, lower=1)[0]
    middle = (start + end) / 2
    ramp = (middle - middle.mean()) / max(float(np.ptp(middle)), 1e-9)
    columns = np.column_stack([legvander(2 * ramp, order), np.frombuffer(warmth).reshape(len(middle), -1)])
    polynomial, r = np.linalg.qr(inverse @ columns)
    full_logdet = 2 * float(np.log(np.diag(factor)).sum())
    restricted = full_logdet + 2 * float(np.log(np.abs(np.diag(r))).sum())
    return np.asarray(inverse), np.asarray(polynomial), restricted, full_logdet


@lru_cache(maxsize=8)
def _flicker(key: bytes) -> Array:
    return flicker_covariance(*np.frombuffer(key).reshape(2, -1))
