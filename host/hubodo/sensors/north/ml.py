"""Maximum likelihood for north: Earth rate and the gyro's own drift fitted to one record together.

    y_i = C cos(a_i) + S sin(a_i) + bias + ramp t_i + drift(t_i) + noise_i

with a the angle of the sensing axis anticlockwise from table zero, C = horizontal cos(azimuth) and
S = horizontal sin(azimuth) of table zero. y are averages over short intervals; drift is rate random walk plus
flicker, with quantisation or shaking where the record shows them (`drift`). Bias and ramp are integrated out
(restricted likelihood), the noise level N too; the ratios of flicker and random walk to it are weighed by
their likelihood on a grid rather than fixed at its best point, so that what the record cannot tell about its
drift widens sigma. Where angles were felt by the gyro itself, the error of its scale is one more unknown with
a prior.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.sensors.north.averages import Averages
from hubodo.sensors.north.drift import Drift
from hubodo.sensors.north.whitening import NUISANCES, Ratios, Sufficient, pieces_of, sufficient

Array = NDArray[np.float64]

FLICKER_RATIOS = (0.0, 0.01, 0.04, 0.16, 0.64, 2.5, 10.0, 40.0, 160.0)
"""B² T / N² with T the mean interval: variance of flicker against that of white noise in one interval."""
WALK_RATIOS = (0.0, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0)
"""K² T² / N², the same for random walk."""
SHAKE_RATIOS = (0.0, 1.0, 10.0, 100.0, 1e3, 1e4)
"""Q² / (N² T), the same for quantisation and shaking, of which one is chosen beforehand."""
_SHAKEN = 4.0
"""Of log likelihood: what shaking must explain before it is believed."""
_MORE = 4.0
"""Sigmas of the noise's own size by which a record must have more than was given."""
_ROUNDS = 8
_STRAIGHT = 1e-3
"""rad at the far end of all turns: what a straight line may still miss of the scale's error."""


@dataclass(frozen=True)
class Posterior:
    """What the record says about Earth rate.

    rate: (2,) C and S, rad/s, not held to the length that latitude demands; rate_covariance (2, 2), infinite
    along a direction that was never measured; angle_covariance (2, 2): what of it the angles bring, where the
    gyro felt them. azimuth: (G,) rad and density (G,) with the known length. drift: the most likely one.
    scale, scale_sigma: error of the gyro's scale, as far as the record shows it.
    """

    rate: Array
    rate_covariance: Array
    angle_covariance: Array
    azimuth: Array
    density: Array
    drift: Drift
    scale: float
    scale_sigma: float


def estimate(
    records: Sequence[Averages], horizontal: float, drift: Drift | None = None, scale_sigma: float = 0.0
) -> Posterior:
    """Posterior of C, S and azimuth from records that share table zero and the drift's size, not its bias.

    horizontal: rad/s of Earth rate along an axis that points north. drift: None to fit it from the records;
    one that is given is widened where they have clearly more noise.
    scale_sigma: 1 sigma of the relative error of the angles that a table was felt to turn.
    """
    pieces = pieces_of(records)
    mean = float(np.mean(np.concatenate([p.end - p.start for p in pieces])))
    freedom = sum(len(p.y) for p in pieces) - NUISANCES * len(pieces)
    reach = max((float(np.abs(p.turned).max()) for p in pieces), default=0.0)
    if drift is None:
        shake = _shaking(pieces, horizontal, freedom, mean)
        grid = [(f, w, shake) for f in FLICKER_RATIOS for w in WALK_RATIOS]
    else:
        grid = [_ratios(drift, mean)]
    if drift is not None:
        drift = _widened(pieces, drift, horizontal, freedom, mean)
    level = None if drift is None else drift.n**2 / mean
    scale = 0.0
    coarse = np.radians(np.arange(-180, 180, 0.25))
    for _ in range(_ROUNDS if scale_sigma and reach else 1):
        terms = sufficient(pieces, grid, mean, scale)
        look = _Look(terms, horizontal, freedom, level, scale, scale_sigma)
        table = look.log_density(coarse)
        step = look.scale_step(coarse, table)
        if abs(step) * reach < _STRAIGHT:
            break
        scale += step
    best = int(table.max(axis=1).argmax())
    share = np.exp(table - table.max())
    weight = share.sum(axis=1) / share.sum()
    azimuth, density = _closer(look.log_density, coarse, share.sum(axis=0))
    rate, spread, angles, left = look.free(weight, float(azimuth[density.argmax()]))
    likely = drift or _drift_of(terms[best], grid[best], freedom, mean)
    return Posterior(rate, spread, angles, azimuth, density / density.sum(), likely, scale, left)


def azimuth_bound(records: Sequence[Averages], drift: Drift, azimuth: float, horizontal: float) -> float:
    """Cramér-Rao bound of azimuth, rad: what these intervals can tell where the drift's N, B, K are known.

    Bias and ramp are unknown, the length of Earth rate is known; infinite where nothing is across it.
    """
    pieces = pieces_of(records)
    mean = float(np.mean(np.concatenate([p.end - p.start for p in pieces])))
    (term,) = sufficient(pieces, [_ratios(drift, mean)], mean)
    across = horizontal * np.array([-np.sin(azimuth), np.cos(azimuth)])
    information = float(across @ term.gram[:2, :2] @ across) * mean / drift.n**2
    return 1 / float(np.sqrt(information)) if information > 0 else float("inf")


@dataclass(frozen=True)
class _Look:
    """The records about one error of scale, straight in what it may still be off.

    level: known variance of a white average, None when it is to be found. scale, scale_sigma: where this
    looks from, and the prior about zero.
    """

    terms: Sequence[Sufficient]
    horizontal: float
    freedom: int
    level: float | None
    scale: float
    scale_sigma: float

    def log_density(self, azimuth: Array) -> Array:
        """(grid, A): log likelihood of each drift and azimuth, but for a constant."""
        rows = []
        for term in self.terms:
            level = self._level(term)
            rss, _, information = self._straight(term, azimuth, level)
            narrowed = -0.5 * np.log1p(information * self.scale_sigma**2 / level)
            if self.level is None:
                rows.append(-0.5 * self.freedom * np.log(rss / self.freedom) - 0.5 * term.logdet + narrowed)
            else:
                rows.append(-0.5 * rss / self.level + narrowed)
        return np.array(rows)

    def scale_step(self, azimuth: Array, table: Array) -> float:
        """From where this looks to the most likely error of scale; table: of `log_density`."""
        if not self.scale_sigma:
            return 0.0
        k, a = np.unravel_index(int(table.argmax()), table.shape)
        term = self.terms[int(k)]
        return float(self._straight(term, azimuth[a : a + 1], self._level(term))[1][0])

    def free(self, weight: Array, azimuth: float) -> tuple[Array, Array, Array, float]:
        """Mean and covariance of C, S over the grid without the known length, what angles bring, scale left.

        weight: (grid,). azimuth: rad, about which the scale's error acts.
        """
        v = self.horizontal * np.array([np.cos(azimuth), np.sin(azimuth)])
        fold = np.zeros((5, 3))
        fold[:2, :2], fold[2:4, 2] = np.eye(2), v
        grams = [(fold.T @ term.gram @ fold, fold.T @ term.gram[:, 4]) for term in self.terms]
        total = sum(w * gram[:2, :2] for w, (gram, _) in zip(weight, grams, strict=True))
        values, vectors = np.linalg.eigh(total)
        seen = values > values[-1] * 1e-4
        basis = vectors[:, seen]
        means, spreads, angled, scales = [], [], [], []
        for term, (gram, score) in zip(self.terms, grams, strict=True):
            inverse = np.linalg.inv(basis.T @ gram[:2, :2] @ basis)
            leak = inverse @ (basis.T @ gram[:2, 2])
            level, rest = self._level(term), 0.0
            found = inverse @ (basis.T @ score[:2])
            off = 0.0
            if self.scale_sigma:
                prior = level / self.scale_sigma**2
                alone = float(gram[2, 2] - gram[:2, 2] @ basis @ leak)
                rest = level / (alone + prior)
                off = float(score[2] - gram[:2, 2] @ basis @ found - prior * self.scale) / (alone + prior)
            means.append(found - leak * off)
            spreads.append(inverse * level)
            angled.append(np.outer(leak, leak) * rest)
            scales.append(rest)
        centre = np.average(means, axis=0, weights=weight)
        among = np.average([np.outer(m - centre, m - centre) for m in means], axis=0, weights=weight)
        angles = basis @ np.average(angled, axis=0, weights=weight) @ basis.T
        covariance = basis @ (np.average(spreads, axis=0, weights=weight) + among) @ basis.T + angles
        if not seen.all():
            blind = vectors[:, ~seen]
            covariance = covariance + 1e6 * blind @ blind.T
        return basis @ centre, covariance, angles, float(np.sqrt(np.average(scales, weights=weight)))

    def _level(self, term: Sufficient) -> float:
        """Variance of a white average: known, or what the best C, S and scale leave of the record."""
        if self.level is not None:
            return self.level
        count = 4 if self.scale_sigma else 2
        gram, score = term.gram[:count, :count], term.gram[:count, 4]
        found = np.linalg.lstsq(gram, score, rcond=1e-9)[0]
        left = float(term.gram[4, 4] - score @ found)
        return max(left, 1e-12 * float(term.gram[4, 4]), 1e-300) / max(1, self.freedom - count)

    def _straight(self, term: Sufficient, azimuth: Array, level: float) -> tuple[Array, Array, Array]:
        """(A,) sum of squares with the scale's best error and its prior; step to that error; information."""
        gram = term.gram
        v = self.horizontal * np.stack([np.cos(azimuth), np.sin(azimuth)])
        rss = gram[4, 4] - 2 * gram[:2, 4] @ v + np.einsum("ik,ij,jk->k", v, gram[:2, :2], v)
        if not self.scale_sigma:
            return rss, np.zeros(len(azimuth)), np.zeros(len(azimuth))
        pull = gram[2:4, 4] @ v - np.einsum("ik,ij,jk->k", v, gram[2:4, :2], v)
        information = np.einsum("ik,ij,jk->k", v, gram[2:4, 2:4], v)
        prior = level / self.scale_sigma**2
        step = (pull - prior * self.scale) / (information + prior)
        rss = rss - 2 * step * pull + step**2 * information + prior * (step + self.scale) ** 2
        return rss, step, information


def _ratios(drift: Drift, mean: float) -> Ratios:
    n = drift.n**2
    return drift.b**2 * mean / n, drift.k**2 * mean**2 / n, drift.q**2 / (n * mean)


def _widened(pieces: Sequence[Averages], drift: Drift, horizontal: float, freedom: int, mean: float) -> Drift:
    """A drift that was given, made larger where the record has clearly more noise than it allows."""
    (term,) = sufficient(pieces, [_ratios(drift, mean)], mean)
    found = _Look([term], horizontal, freedom, None, 0.0, 0.0)._level(term)
    more = found * mean / drift.n**2
    if more < 1 + _MORE * np.sqrt(2 / max(freedom, 1)):
        return drift
    times = float(np.sqrt(more))
    return Drift(times * drift.n, times * drift.b, times * drift.k, times * drift.q)


def _shaking(pieces: Sequence[Averages], horizontal: float, freedom: int, mean: float) -> float:
    """The most likely of SHAKE_RATIOS beside a little drift; 0 unless another is clearly better."""
    azimuth = np.radians(np.arange(-180, 180, 5.0))
    best = []
    for shake in SHAKE_RATIOS:
        grid = [(f, w, shake) for f in (0.0, 0.64) for w in (0.0, 1e-2)]
        look = _Look(sufficient(pieces, grid, mean), horizontal, freedom, None, 0.0, 0.0)
        best.append(float(look.log_density(azimuth).max()))
    likely = int(np.argmax(best))
    return SHAKE_RATIOS[likely] if best[likely] > best[0] + _SHAKEN else 0.0


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


def _drift_of(term: Sufficient, ratios: Ratios, freedom: int, mean: float) -> Drift:
    """N, B, K, Q of the point of the grid whose ratios these are, by what its best C and S leave."""
    gram, score = term.gram[:2, :2], term.gram[:2, 4]
    found = np.linalg.lstsq(gram, score, rcond=1e-9)[0]
    level = max(float(term.gram[4, 4] - score @ found), 1e-300) / max(1, freedom - 2) * mean
    f, w, q = (float(np.sqrt(ratio * level)) for ratio in ratios)
    return Drift(float(np.sqrt(level)), f / float(np.sqrt(mean)), w / mean, q * float(np.sqrt(mean)))
