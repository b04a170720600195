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
from functools import cached_property

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.sensors.north.averages import Averages
from hubodo.sensors.north.drift import Drift
from hubodo.sensors.north.whitening import BEND, RAMP, Ratios, Sufficient, pieces_of, sufficient

FLICKER_RATIOS = (0.0, 0.01, 0.04, 0.16, 0.64, 2.5, 10.0, 40.0, 160.0)
"""B² T / N² with T the mean interval: variance of flicker against that of white noise in one interval."""
WALK_RATIOS = (0.0, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0)
"""K² T² / N², the same for random walk."""
SHAKE_RATIOS = (0.0, 1.0, 10.0, 100.0, 1e3, 1e4)
"""Q² / (N² T), the same for quantisation and shaking, of which one is chosen beforehand."""
UNSEEN = 1e-2
"""(rad/s)², variance of what was never measured: far beyond Earth rate, but what was measured must not be
lost beside it in rounding.
"""
_BENT = 6.0
"""Of log likelihood, for each piece: what two more terms of its polynomial must explain."""
_SHAKEN = 4.0
"""Of log likelihood: what shaking must explain before it is believed."""
_MORE = 4.0
"""Sigmas of the noise's own size by which a record must have more than was given."""
_STRAIGHT = 0.1
"""rad at the far end of all turns, up to which angles are straight in the error of the gyro's scale."""
_NARROW = 0.3
_CENTRES = np.linspace(-3.0, 3.0, 21)
"""1 sigma of the parts of its prior where they are not, and where these lie; in sigmas of the prior."""
_AROUND = np.radians(np.arange(-180, 180, 5.0))
_LITTLE_FLICKER, _LITTLE_WALK = (0.0, 0.64), (0.0, 1e-2)
"""Azimuths, rad, and ratios: enough to compare what may be in a record beside Earth rate and drift."""


@dataclass(frozen=True)
class Posterior:
    """What the record says about Earth rate.

    rate: (2,) C and S, rad/s, not held to the length that latitude demands; rate_covariance (2, 2), UNSEEN
    along a direction that was never measured; angle_covariance (2, 2): what of it the angles bring, where the
    gyro felt them. azimuth: (G,) rad and density (G,) with the known length. drift: the most likely one.
    order: of the polynomial that went with bias and ramp.
    """

    rate: Array
    rate_covariance: Array
    angle_covariance: Array
    azimuth: Array
    density: Array
    drift: Drift
    order: int


def estimate(
    records: Sequence[Averages], horizontal: float, drift: Drift | None = None, scale_sigma: float = 0.0
) -> Posterior:
    """Posterior of C, S and azimuth from records that share table zero and the drift's size, not its bias.

    horizontal: rad/s of Earth rate along an axis that points north. drift: None to fit it from the records;
    one that is given is widened where they have clearly more noise.
    scale_sigma: 1 sigma of the relative error of the angles that a table was felt to turn. Raises InputError
    where the records are empty.
    """
    pieces = pieces_of(records)
    if not pieces:
        raise InputError("no part of any stop has time stamps that its samples can have; record it again")
    mean = float(np.mean(np.concatenate([p.end - p.start for p in pieces])))
    order = _order(pieces, horizontal, mean)
    freedom = sum(len(p.y) for p in pieces) - (order + 1) * len(pieces)
    reach = max(float(np.abs(p.turned).max()) for p in pieces)
    if drift is None:
        shake = _shaking(pieces, horizontal, freedom, mean, order)
        grid = [(f, w, shake) for f in FLICKER_RATIOS for w in WALK_RATIOS]
    else:
        grid = [_ratios(drift, mean)]
    if drift is not None:
        drift = _widened(pieces, drift, horizontal, freedom, mean, order)
    level = None if drift is None else drift.n**2 / mean
    looks = [
        _Look(sufficient(pieces, grid, mean, scale, order), horizontal, freedom, level, width, weight)
        for scale, width, weight in _scales(scale_sigma if reach else 0.0, reach)
    ]

    def log_density(azimuth: Array) -> Array:
        return np.concatenate([look.log_density(azimuth) for look in looks])

    coarse = np.radians(np.arange(-180, 180, 0.25))
    table = log_density(coarse)
    best = int(table.max(axis=1).argmax())
    share = np.exp(table - table.max())
    weight = share.sum(axis=1) / share.sum()
    azimuth, density = _closer(log_density, coarse, share.sum(axis=0))
    rate, spread, angles = _moments(looks, weight, float(azimuth[density.argmax()]))
    term, ratios = looks[best // len(grid)].terms[best % len(grid)], grid[best % len(grid)]
    likely = drift or _drift_of(term, ratios, freedom, mean)
    return Posterior(rate, spread, angles, azimuth, density / density.sum(), likely, order)


def azimuth_bound(
    records: Sequence[Averages], posterior: Posterior, azimuth: float, horizontal: float
) -> float:
    """Cramér-Rao bound of azimuth, rad: what these intervals can tell where the drift's N, B, K are known.

    Of the posterior's drift and order. Bias and ramp are unknown, the length of Earth rate is known;
    infinite where nothing is across it.
    """
    drift = posterior.drift
    pieces = pieces_of(records)
    mean = float(np.mean(np.concatenate([p.end - p.start for p in pieces])))
    (term,) = sufficient(pieces, [_ratios(drift, mean)], mean, order=posterior.order)
    across = horizontal * np.array([-np.sin(azimuth), np.cos(azimuth)])
    information = float(across @ term.gram[:2, :2] @ across) * mean / drift.n**2
    return 1 / float(np.sqrt(information)) if information > 0 else float("inf")


def _scales(sigma: float, reach: float) -> list[tuple[float, float, float]]:
    """(centre, 1 sigma, log weight) of narrow Gaussians that together are the prior of the scale's error.

    Within each of them the angles, which turn up to `reach` rad, are straight in that error.
    """
    if sigma * reach < _STRAIGHT:
        return [(0.0, sigma, 0.0)]
    width = _NARROW * sigma
    centre = sigma * _CENTRES
    weight = -0.5 * centre**2 / (sigma**2 - width**2)
    return [(float(c), width, float(w)) for c, w in zip(centre, weight, strict=True)]


@dataclass(frozen=True)
class _Look:
    """The records about one error of scale, straight in what it may still be off.

    level: known variance of a white average, None when it is to be found. width: 1 sigma of the error about
    the one looked from; weight: logarithm of the share of the prior here.
    """

    terms: Sequence[Sufficient]
    horizontal: float
    freedom: int
    level: float | None
    width: float = 0.0
    weight: float = 0.0

    def log_density(self, azimuth: Array) -> Array:
        """(grid, A): log likelihood of each drift and azimuth, but for a constant."""
        rows = []
        v = self.horizontal * np.stack([np.cos(azimuth), np.sin(azimuth)])
        for term, level in zip(self.terms, self.levels, strict=True):
            rss, information = self._straight(term, v, level)
            row = self.weight - 0.5 * np.log1p(information * self.width**2 / level)
            if self.level is None:
                row = row - 0.5 * self.freedom * np.log(rss / self.freedom) - 0.5 * term.logdet
            else:
                row = row - 0.5 * rss / self.level
            rows.append(row)
        return np.array(rows)

    @cached_property
    def levels(self) -> tuple[float, ...]:
        """Of each of the terms, see `level_of`."""
        return tuple(map(self.level_of, self.terms))

    def free(self, term: Sufficient, level: float, basis: Array, v: Array) -> tuple[Array, Array, Array]:
        """C and S in the directions of `basis` without the known length, their covariance, what angles add.

        level: of the term. v: (2,) rad/s, about which the scale's error acts.
        """
        fold = np.zeros((5, 3))
        fold[:2, :2], fold[2:4, 2] = np.eye(2), v
        gram, score = fold.T @ term.gram @ fold, fold.T @ term.gram[:, 4]
        inverse: Array = np.asarray(np.linalg.inv(basis.T @ gram[:2, :2] @ basis), np.float64)
        found = inverse @ (basis.T @ score[:2])
        spread = np.asarray(inverse * level, np.float64)
        if not self.width:
            return found, spread, np.zeros((len(found), len(found)))
        leak = inverse @ (basis.T @ gram[:2, 2])
        known = float(gram[2, 2] - gram[:2, 2] @ basis @ leak) + level / self.width**2
        off = float(score[2] - gram[:2, 2] @ basis @ found) / known
        return found - leak * off, spread, np.asarray(np.outer(leak, leak) * level / known)

    def level_of(self, term: Sufficient) -> float:
        """Variance of a white average: known, or what the best C, S and scale leave of the record."""
        if self.level is not None:
            return self.level
        count = 4 if self.width else 2
        gram, score = term.gram[:count, :count], term.gram[:count, 4]
        found = np.linalg.lstsq(gram, score, rcond=1e-9)[0]
        left = float(term.gram[4, 4] - score @ found)
        return max(left, 1e-12 * float(term.gram[4, 4]), 1e-300) / max(1, self.freedom - count)

    def _straight(self, term: Sufficient, v: Array, level: float) -> tuple[Array, Array]:
        """(A,) sum of squares with the scale's best error and its prior; information of that error.

        v: (2, A) rad/s, Earth rate along the axis at table zero and a quarter turn on.
        """
        gram = term.gram
        rss = gram[4, 4] - 2 * gram[:2, 4] @ v + np.einsum("ik,ij,jk->k", v, gram[:2, :2], v)
        if not self.width:
            return rss, np.zeros(v.shape[1])
        pull = gram[2:4, 4] @ v - np.einsum("ik,ij,jk->k", v, gram[2:4, :2], v)
        information = np.einsum("ik,ij,jk->k", v, gram[2:4, 2:4], v)
        return rss - pull**2 / (information + level / self.width**2), information


def _moments(looks: Sequence[_Look], weight: Array, azimuth: float) -> tuple[Array, Array, Array]:
    """Mean and covariance of C, S over drifts and scales without the known length, and what angles bring.

    weight: (looks * grid,). azimuth: rad, the most likely.
    """
    v = looks[0].horizontal * np.array([np.cos(azimuth), np.sin(azimuth)])
    terms = [(look, *each) for look in looks for each in zip(look.terms, look.levels, strict=True)]
    total = sum(w * term.gram[:2, :2] for w, (_, term, _) in zip(weight, terms, strict=True))
    values, vectors = np.linalg.eigh(total)
    seen = values > values[-1] * 1e-4
    basis = vectors[:, seen]
    found = [look.free(term, level, basis, v) for look, term, level in terms]
    means = np.array([mean for mean, _, _ in found])
    centre = np.average(means, axis=0, weights=weight)
    among = np.einsum("k,ki,kj->ij", weight, means - centre, means - centre)
    spread = np.average([one for _, one, _ in found], axis=0, weights=weight)
    angles = np.average([one for *_, one in found], axis=0, weights=weight)
    if len(looks) > 1:
        # What the scale looked from moves is the angles' too; drifts move it as well, a little.
        angles, among = angles + among, np.zeros_like(among)
    covariance = basis @ (spread + among + angles) @ basis.T
    if not seen.all():
        covariance = covariance + UNSEEN * np.outer(vectors[:, 0], vectors[:, 0])
    return basis @ centre, covariance, basis @ angles @ basis.T


def _ratios(drift: Drift, mean: float) -> Ratios:
    n = drift.n**2
    return drift.b**2 * mean / n, drift.k**2 * mean**2 / n, drift.q**2 / (n * mean)


def _widened(
    pieces: Sequence[Averages], drift: Drift, horizontal: float, freedom: int, mean: float, order: int
) -> Drift:
    """A drift that was given, made larger where the record has clearly more noise than it allows."""
    (term,) = sufficient(pieces, [_ratios(drift, mean)], mean, order=order)
    found = _Look([term], horizontal, freedom, None).level_of(term)
    more = found * mean / drift.n**2
    if more < 1 + _MORE * np.sqrt(2 / max(freedom, 1)):
        return drift
    times = float(np.sqrt(more))
    return Drift(times * drift.n, times * drift.b, times * drift.k, times * drift.q)


def _order(pieces: Sequence[Averages], horizontal: float, mean: float) -> int:
    """RAMP, or BEND where a curve explains clearly more than drift does, whatever its size.

    By the likelihood that is not restricted, as the restricted ones of two polynomials cannot be compared.
    """
    count = sum(len(p.y) for p in pieces)
    grid = [(f, w, 0.0) for f in _LITTLE_FLICKER for w in WALK_RATIOS]
    best = []
    for order in (RAMP, BEND):
        terms = sufficient(pieces, grid, mean, order=order)
        look = _Look(terms, horizontal, count, None)
        plain = np.array([0.5 * (term.logdet - term.plain) for term in terms])
        best.append(float((look.log_density(_AROUND) + plain[:, None]).max()))
    return BEND if best[1] > best[0] + _BENT * len(pieces) else RAMP


def _shaking(pieces: Sequence[Averages], horizontal: float, freedom: int, mean: float, order: int) -> float:
    """The most likely of SHAKE_RATIOS beside a little drift; 0 unless another is clearly better."""
    best = []
    for shake in SHAKE_RATIOS:
        grid = [(f, w, shake) for f in _LITTLE_FLICKER for w in _LITTLE_WALK]
        look = _Look(sufficient(pieces, grid, mean, order=order), horizontal, freedom, None)
        best.append(float(look.log_density(_AROUND).max()))
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
