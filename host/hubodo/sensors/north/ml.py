"""Maximum likelihood for north: Earth rate and the gyro's own drift fitted to one record together.

    y_i = C cos(a_i) + S sin(a_i) + bias + drift(t_i) + noise_i

with a the angle of the sensing axis anticlockwise from table zero, C = Omega cos(latitude) cos(azimuth) and
S = Omega cos(latitude) sin(azimuth) of table zero. y are averages over short intervals; drift is rate random
walk plus flicker (`drift`). Constant bias is integrated out (restricted likelihood), the noise level N
too; the ratios of flicker and random walk to it are weighed by their likelihood on a grid rather than fixed
at its best point, so that what the record cannot tell about its drift widens sigma.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular

from hubodo.sensors.north.drift import Drift, flicker, random_walk

Array = NDArray[np.float64]

Sufficient = tuple[Array, Array, float, float]
"""Sufficient statistics: information (2, 2), score (2,), quadratic form and log determinant of a record."""

FLICKER_RATIOS = (0.0, 0.01, 0.04, 0.16, 0.64, 2.5, 10.0, 40.0, 160.0)
"""B² T / N² with T the mean interval: variance of flicker against that of white noise in one interval."""
WALK_RATIOS = (0.0, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0)
"""K² T² / N², the same for random walk."""
PIECE = 300
"""Intervals solved together; longer records are cut into pieces with a bias each.

That costs little: the drift of one piece says next to nothing about Earth rate in another.
"""


@dataclass(frozen=True)
class Averages:
    """M averages in order of time.

    start, end: (M,) s. y: (M,) rad/s. cos, sin: (M,) means over each interval.
    """

    start: Array
    end: Array
    y: Array
    cos: Array
    sin: Array


@dataclass(frozen=True)
class Posterior:
    """What the record says about Earth rate.

    rate: (2,) C and S, rad/s, not held to the length that latitude demands; rate_covariance (2, 2), infinite
    along a direction that was never measured. azimuth: (G,) rad and probability (G,) density with the known
    length. drift: the most likely one.
    """

    rate: Array
    rate_covariance: Array
    azimuth: Array
    density: Array
    drift: Drift


def average(t: Array, y: Array, angle: Array, spans: Sequence[tuple[int, int]], length: float) -> Averages:
    """Averages over equal parts, of about `length` s, of each span of samples [i, j)."""
    step = float(np.median(np.diff(t)))
    rows = []
    for i, j in spans:
        count = max(1, round((j - i) * step / length))
        edges = np.linspace(i, j, count + 1).round().astype(int)
        for a, b in pairwise(edges):
            if b > a:
                part = angle[a:b]
                rows.append((t[a], t[b - 1] + step, y[a:b].mean(), np.cos(part).mean(), np.sin(part).mean()))
    return Averages(*np.array(rows).T)


def estimate(averages: Averages, horizontal: float, drift: Drift | None = None) -> Posterior:
    """Posterior of C, S and azimuth.

    horizontal: Omega cos(latitude), rad/s. drift: None to fit it from the record.
    """
    return combine([averages], horizontal, drift)


def combine(records: Sequence[Averages], horizontal: float, drift: Drift | None = None) -> Posterior:
    """Posterior from several gyros, or records of one, that share table zero and drift like each other."""
    pieces = [piece for record in records for piece in _pieces(record)]
    mean = float(np.mean(np.concatenate([p.end - p.start for p in pieces])))
    if drift is None:
        grid = [(f, w) for f in FLICKER_RATIOS for w in WALK_RATIOS]
    else:
        grid = [(drift.b**2 * mean / drift.n**2, drift.k**2 * mean**2 / drift.n**2)]
    freedom = sum(len(p.y) for p in pieces) - len(pieces)
    terms = _terms(pieces, grid, mean)

    def log_density(azimuth: Array) -> Array:
        v = horizontal * np.stack([np.cos(azimuth), np.sin(azimuth)])
        rows = []
        for information, score, quadratic, logdet in terms:
            rss = quadratic - 2 * score @ v + np.einsum("ik,ij,jk->k", v, information, v)
            if drift is None:
                rows.append(-0.5 * freedom * np.log(rss / freedom) - 0.5 * logdet)
            else:
                rows.append(-0.5 * rss * mean / (drift.n**2))
        return np.array(rows)

    coarse = np.radians(np.arange(-180, 180, 0.25))
    table = log_density(coarse)
    best = int(table.max(axis=1).argmax())
    share = np.exp(table - table.max())
    weight = share.sum(axis=1) / share.sum()
    azimuth, density = _closer(log_density, coarse, share.sum(axis=0))
    rate, spread = _free(terms, weight, freedom, drift, mean)
    likely = drift or _drift_of(terms[best], grid[best], freedom, mean)
    return Posterior(rate, spread, azimuth, density / density.sum(), likely)


def _terms(pieces: Sequence[Averages], grid: Sequence[tuple[float, float]], mean: float) -> list[Sufficient]:
    """What `_sufficient` gives, summed over the pieces, at each point of the grid."""
    # Same stops, same matrix: programmes repeat from record to record, so rounding makes them meet in the
    # cache.
    keys = [np.round(np.stack([p.start, p.end]) - p.start[0], 4).tobytes() for p in pieces]
    unit = round(mean, 4)
    terms = []
    for f, w in grid:
        information, score, quadratic, logdet = np.zeros((2, 2)), np.zeros(2), 0.0, 0.0
        for key, piece in zip(keys, pieces, strict=True):
            lam, eta, q, ld = _sufficient(piece, *_whitener(key, f, w, unit))
            information, score = information + lam, score + eta
            quadratic, logdet = quadratic + q, logdet + ld
        terms.append((information, score, quadratic, logdet))
    return terms


def _closer(log_density: Callable[[Array], Array], azimuth: Array, density: Array) -> tuple[Array, Array]:
    """Azimuths, rad, and density about the peak where it is narrower than the grid; else as they were."""
    if (density > density.max() * 1e-3).sum() >= 60:
        return azimuth, density
    width = max(int((density > density.max() * 1e-6).sum()), 2) * np.radians(0.25)
    for _ in range(6):
        centre = float(azimuth[density.argmax()])
        azimuth = centre + np.linspace(-width, width, 801)
        fine = log_density(azimuth)
        density = np.exp(fine - fine.max()).sum(axis=0)
        inside = np.count_nonzero(density > density.max() * 1e-6)
        if inside > 100:
            break
        width = max(width * inside / 400, 1e-9)
    return azimuth, density


def _drift_of(term: Sufficient, ratios: tuple[float, float], freedom: int, mean: float) -> Drift:
    """N, B, K of the point of the grid whose ratios these are, by what its best C and S leave."""
    information, score, quadratic, _ = term
    found = np.linalg.lstsq(information, score, rcond=1e-9)[0]
    level = max(quadratic - float(score @ found), 1e-300) / max(1, freedom - 2) * mean
    f, w = ratios
    return Drift(float(np.sqrt(level)), float(np.sqrt(f * level / mean)), float(np.sqrt(w * level) / mean))


def _free(
    terms: Sequence[Sufficient],
    weight: Array,
    freedom: int,
    drift: Drift | None,
    mean: float,
) -> tuple[Array, Array]:
    """Mean and covariance of C, S over the grid, without the known length."""
    means, spreads = [], []
    total = sum(w * information for w, (information, *_) in zip(weight, terms, strict=True))
    values, vectors = np.linalg.eigh(total)
    seen = values > values[-1] * 1e-4
    basis = vectors[:, seen]
    for information, score, quadratic, _ in terms:
        inverse = np.linalg.inv(basis.T @ information @ basis)
        found = inverse @ (basis.T @ score)
        left = max(quadratic - float(basis.T @ score @ found), 0.0)
        level = left / max(1, freedom - len(found)) if drift is None else drift.n**2 / mean
        means.append(found)
        spreads.append(inverse * level)
    centre = np.average(means, axis=0, weights=weight)
    spread = sum(
        w * (s + np.outer(m - centre, m - centre)) for w, m, s in zip(weight, means, spreads, strict=True)
    )
    covariance = basis @ spread @ basis.T
    if not seen.all():
        blind = vectors[:, ~seen]
        covariance = covariance + 1e6 * blind @ blind.T
    return basis @ centre, covariance


def _pieces(record: Averages) -> list[Averages]:
    count = max(1, -(-len(record.y) // PIECE))
    edges = np.linspace(0, len(record.y), count + 1).round().astype(int)
    fields = (record.start, record.end, record.y, record.cos, record.sin)
    return [Averages(*(v[a:b] for v in fields)) for a, b in pairwise(edges)]


def _sufficient(piece: Averages, whitener: Array, logdet: float) -> Sufficient:
    """Information (2, 2), score (2,), quadratic form and log determinant with the bias integrated out."""
    columns = np.column_stack([np.ones(len(piece.y)), piece.cos, piece.sin, piece.y])
    white = whitener @ columns
    one, rest = white[:, 0], white[:, 1:]
    norm = float(one @ one)
    rest = rest - np.outer(one, one @ rest) / norm
    gram = rest.T @ rest
    return gram[:2, :2], gram[:2, 2], float(gram[2, 2]), logdet + float(np.log(norm))


@lru_cache(maxsize=160)
def _whitener(key: bytes, f: float, w: float, unit: float) -> tuple[Array, float]:
    """Inverse Cholesky factor and log determinant of the covariance in units of N² / unit.

    key: start and end, float64.
    """
    start, end = np.frombuffer(key).reshape(2, -1)
    matrix = np.diag(unit / (end - start)) + w / unit * random_walk(start, end)
    if f:
        matrix = matrix + f * _flicker(key)
    factor = cholesky(matrix, lower=True, check_finite=False)
    inverse = solve_triangular(factor, np.eye(len(factor)), lower=True, check_finite=False)
    return np.asarray(inverse), 2 * float(np.log(np.diag(factor)).sum())


@lru_cache(maxsize=8)
def _flicker(key: bytes) -> Array:
    return flicker(*np.frombuffer(key).reshape(2, -1))
