"""Maximum-likelihood north finding: joint estimation of horizontal Earth rate and the gyro's drift.

    y_i = C cos(a_i) + S sin(a_i) + bias + ramp t_i + drift(t_i) + noise_i

a is the angle of the sensing axis, anticlockwise from table zero; C = horizontal cos(azimuth) and S =
horizontal sin(azimuth), with the azimuth of table zero. y are averages over short intervals. drift is rate
random walk plus flicker, with quantisation or vibration if the record shows them (module `drift`). Bias,
ramp and noise level N are integrated out (restricted likelihood). The ratios of flicker and random walk to
N are marginalised on a grid, so that the uncertainty of the drift is part of sigma. If the gyro itself
measured the table angles, the error of its scale factor is a further unknown with a prior.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.sensors.north.averages import Averages
from hubodo.sensors.north.drift import DriftNoise
from hubodo.sensors.north.whitening import (
    BEND_ORDER,
    RAMP_ORDER,
    NoiseRatios,
    SufficientStatistics,
    split_pieces,
    sufficient_statistics,
)

FLICKER_RATIOS = (0.0, 0.01, 0.04, 0.16, 0.64, 2.5, 10.0, 40.0, 160.0)
"""B² T / N² with T the mean interval: ratio of the variances of flicker and white noise in one interval."""
WALK_RATIOS = (0.0, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0)
"""K² T² / N², the same for random walk."""
SHAKE_RATIOS = (0.0, 1.0, 10.0, 100.0, 1e3, 1e4)
"""Q² / (N² T), the same for quantisation and vibration.

One value is selected before the grid is evaluated.
"""
UNMEASURED_VARIANCE = 1e-2
"""Variance of an unmeasured component, (rad/s)²: far above Earth rate, yet small enough to avoid rounding
errors.
"""
UNIFORM_AZIMUTH_SIGMA = float(np.pi / np.sqrt(3.0))
"""Sigma, rad, of an azimuth of which nothing is known."""
_MIN_BEND_GAIN = 6.0
"""Gain of log likelihood per piece that justifies two more polynomial terms."""
_MIN_WARMTH = 0.5  # °C, smallest range of the temperature that is considered
_MIN_VIBRATION_GAIN = 8.0
"""Gain of log likelihood that justifies a vibration or quantisation term.

At 4, one of the first 20 records of white noise in `test_north_disturbed.py` has a sigma that is three times
too small: five ratios are tried. Vibration that gains less than 8 makes sigma too large, not too small.
"""
_EXCESS_NOISE_SIGMA = 4.0
"""Sigmas of the noise level by which a record must exceed the given noise before it is scaled up."""
_MAX_LINEAR_ANGLE_ERROR = 0.1
"""Largest angle error, rad, by the scale factor up to which the model is linear in that error."""
_PRIOR_PART_SIGMA = 0.3
_PRIOR_PART_CENTRES = np.linspace(-3.0, 3.0, 21)
"""Beyond, the prior of the scale error is split into narrow Gaussians: their sigma and centres, in prior
sigmas.
"""
_COARSE_AZIMUTHS = np.radians(np.arange(-180, 180, 5.0))
_COARSE_FLICKER_RATIOS, _COARSE_WALK_RATIOS = (0.0, 0.64), (0.0, 1e-2)
"""Coarse grid of azimuths (rad) and noise ratios, for comparing models."""


@dataclass(frozen=True)
class EarthRatePosterior:
    """The posterior of horizontal Earth rate and azimuth.

    Attributes:
        rate: (2,) C and S, rad/s, without the constraint on their norm by latitude.
        rate_covariance: (2, 2); `UNMEASURED_VARIANCE` along a direction that was not measured.
        angle_covariance: (2, 2) part of `rate_covariance` due to angle errors, if the gyro measured the
            angles.
        azimuth, density: (G,) azimuths, rad, and their posterior density with the known norm.
        drift: most likely drift noise.
        order: order of the polynomial for bias, ramp and bend.
        uses_temperature: True if the bias follows the temperature, with an unknown slope.
    """

    rate: Array
    rate_covariance: Array
    angle_covariance: Array
    azimuth: Array
    density: Array
    drift: DriftNoise
    order: int
    uses_temperature: bool = False


def estimate_earth_rate(
    records: Sequence[Averages], horizontal: float, drift: DriftNoise | None = None, scale_sigma: float = 0.0
) -> EarthRatePosterior:
    """Return the posterior of C, S and azimuth from records with a common table zero and drift level.

    horizontal: Earth rate along an axis that points north, rad/s. drift: None to estimate it; a given
    drift is scaled up if the records have significantly more noise. scale_sigma: relative sigma of the
    scale factor with which the gyro measured the table angles. Raises InputError if the records are empty.
    """
    pieces = split_pieces(records)
    if not pieces:
        raise InputError("no part of any stop has time stamps that its samples can have; record it again")
    mean = float(np.mean(np.concatenate([p.end - p.start for p in pieces])))
    pieces, order = _select_trend(pieces, horizontal, mean)
    uses_temperature = pieces[0].temperature is not None
    freedom = sum(len(p.y) for p in pieces) - (order + 1 + uses_temperature) * len(pieces)
    max_turn = max(float(np.abs(p.turned).max()) for p in pieces)
    if drift is None:
        vibration = _select_vibration(pieces, horizontal, freedom, mean, order)
        grid = [(f, w, vibration) for f in FLICKER_RATIOS for w in WALK_RATIOS]
    else:
        grid = [_noise_ratios(drift, mean)]
    if drift is not None:
        drift = _scale_to_record(pieces, drift, horizontal, freedom, mean, order)
    level = None if drift is None else drift.n**2 / mean
    likelihoods = [
        _ScaleLikelihood(
            sufficient_statistics(pieces, grid, mean, scale, order), horizontal, freedom, level, width, weight
        )
        for scale, width, weight in _split_scale_prior(scale_sigma if max_turn else 0.0, max_turn)
    ]

    def log_density(azimuth: Array) -> Array:
        return np.concatenate([likelihood.log_density(azimuth) for likelihood in likelihoods])

    coarse = np.radians(np.arange(-180, 180, 0.25))
    table = log_density(coarse)
    best = int(table.max(axis=1).argmax())
    share = np.exp(table - table.max())
    weight = share.sum(axis=1) / share.sum()
    azimuth, density = _refine_grid(log_density, coarse, share.sum(axis=0))
    rate, spread, angles = _rate_moments(likelihoods, weight, float(azimuth[density.argmax()]))
    term, ratios = likelihoods[best // len(grid)].terms[best % len(grid)], grid[best % len(grid)]
    best_drift = drift or _drift_from_ratios(term, ratios, freedom, mean)
    return EarthRatePosterior(
        rate, spread, angles, azimuth, density / density.sum(), best_drift, order, uses_temperature
    )


def azimuth_cramer_rao_bound(
    records: Sequence[Averages], posterior: EarthRatePosterior, azimuth: float, horizontal: float
) -> float:
    """Return the Cramér-Rao bound of the azimuth sigma, rad, for known drift parameters N, B, K.

    Uses drift and polynomial order of the posterior. Bias and ramp are unknown, the norm of Earth rate is
    known. The bound is infinite if the records contain no information across Earth rate.
    """
    drift = posterior.drift
    pieces = split_pieces(records)
    if not posterior.uses_temperature:
        pieces = _without_temperature(pieces)
    mean = float(np.mean(np.concatenate([p.end - p.start for p in pieces])))
    (term,) = sufficient_statistics(pieces, [_noise_ratios(drift, mean)], mean, order=posterior.order)
    across = horizontal * np.array([-np.sin(azimuth), np.cos(azimuth)])
    information = float(across @ term.gram[:2, :2] @ across) * mean / drift.n**2
    return 1 / float(np.sqrt(information)) if information > 0 else float("inf")


def _split_scale_prior(sigma: float, max_turn: float) -> list[tuple[float, float, float]]:
    """Return (centre, sigma, log weight) of narrow Gaussians whose sum is the prior of the scale error.

    Within each of them the angles, up to `reach` rad, are linear in the scale error.
    """
    if sigma * max_turn < _MAX_LINEAR_ANGLE_ERROR:
        return [(0.0, sigma, 0.0)]
    width = _PRIOR_PART_SIGMA * sigma
    centre = sigma * _PRIOR_PART_CENTRES
    weight = -0.5 * centre**2 / (sigma**2 - width**2)
    return [(float(c), width, float(w)) for c, w in zip(centre, weight, strict=True)]


@dataclass(frozen=True)
class _ScaleLikelihood:
    """The likelihood linearised about one value of the scale error.

    Attributes:
        terms: sufficient statistics, one per grid point of the noise ratios.
        horizontal: norm of horizontal Earth rate, rad/s.
        freedom: degrees of freedom.
        level: variance of a white average, (rad/s)²; None to estimate it.
        width: prior sigma of the scale error about this value.
        weight: logarithm of the prior weight of this value.
    """

    terms: Sequence[SufficientStatistics]
    horizontal: float
    freedom: int
    level: float | None
    width: float = 0.0
    weight: float = 0.0

    def log_density(self, azimuth: Array) -> Array:
        """Return the (grid, A) log likelihoods of each drift and azimuth, up to a constant."""
        rows = []
        v = self.horizontal * np.stack([np.cos(azimuth), np.sin(azimuth)])
        for term, level in zip(self.terms, self.levels, strict=True):
            rss, information = self._profile_scale(term, v, level)
            row = self.weight - 0.5 * np.log1p(information * self.width**2 / level)
            if self.level is None:
                row = row - 0.5 * self.freedom * np.log(rss / self.freedom) - 0.5 * term.logdet
            else:
                row = row - 0.5 * rss / self.level
            rows.append(row)
        return np.array(rows)

    @cached_property
    def levels(self) -> tuple[float, ...]:
        """Return the variance of a white average for each of the terms."""
        return tuple(map(self.estimate_level, self.terms))

    def estimate_rate(
        self, term: SufficientStatistics, level: float, basis: Array, v: Array
    ) -> tuple[Array, Array, Array]:
        """Return C, S along `basis` without norm constraint, their covariance, and its part due to angles.

        level: variance of a white average. v: (2,) C and S about which the effect of the scale error is
        linearised.
        """
        projection = np.zeros((5, 3))
        projection[:2, :2], projection[2:4, 2] = np.eye(2), v
        gram, score = projection.T @ term.gram @ projection, projection.T @ term.gram[:, 4]
        inverse: Array = np.asarray(np.linalg.inv(basis.T @ gram[:2, :2] @ basis), np.float64)
        estimate = inverse @ (basis.T @ score[:2])
        spread = np.asarray(inverse * level, np.float64)
        if not self.width:
            return estimate, spread, np.zeros((len(estimate), len(estimate)))
        scale_effect = inverse @ (basis.T @ gram[:2, 2])
        scale_information = float(gram[2, 2] - gram[:2, 2] @ basis @ scale_effect) + level / self.width**2
        scale_error = float(score[2] - gram[:2, 2] @ basis @ estimate) / scale_information
        return (
            estimate - scale_effect * scale_error,
            spread,
            np.asarray(np.outer(scale_effect, scale_effect) * level / scale_information),
        )

    def estimate_level(self, term: SufficientStatistics) -> float:
        """Return the variance of a white average: given, or from the residuals of the best C, S and scale."""
        if self.level is not None:
            return self.level
        count = 4 if self.width else 2
        gram, score = term.gram[:count, :count], term.gram[:count, 4]
        estimate = np.linalg.lstsq(gram, score, rcond=1e-9)[0]
        residual_power = float(term.gram[4, 4] - score @ estimate)
        return max(residual_power, 1e-12 * float(term.gram[4, 4]), 1e-300) / max(1, self.freedom - count)

    def _profile_scale(self, term: SufficientStatistics, v: Array, level: float) -> tuple[Array, Array]:
        """Return the (A,) sums of squares at the best scale error, and the information about that error.

        v: (2, A) rad/s, Earth rate along the axis at table zero and a quarter turn on.
        """
        gram = term.gram
        rss = gram[4, 4] - 2 * gram[:2, 4] @ v + np.einsum("ik,ij,jk->k", v, gram[:2, :2], v)
        if not self.width:
            return rss, np.zeros(v.shape[1])
        scale_score = gram[2:4, 4] @ v - np.einsum("ik,ij,jk->k", v, gram[2:4, :2], v)
        information = np.einsum("ik,ij,jk->k", v, gram[2:4, 2:4], v)
        return rss - scale_score**2 / (information + level / self.width**2), information


def _rate_moments(
    likelihoods: Sequence[_ScaleLikelihood], weight: Array, azimuth: float
) -> tuple[Array, Array, Array]:
    """Return mean and covariance of C, S over all drifts and scales, and the part due to angles.

    weight: (scales * grid,) posterior weights. azimuth: most likely azimuth, rad. The norm is not
    constrained.
    """
    v = likelihoods[0].horizontal * np.array([np.cos(azimuth), np.sin(azimuth)])
    terms = [
        (likelihood, *each)
        for likelihood in likelihoods
        for each in zip(likelihood.terms, likelihood.levels, strict=True)
    ]
    total = sum(w * term.gram[:2, :2] for w, (_, term, _) in zip(weight, terms, strict=True))
    values, vectors = np.linalg.eigh(total)
    is_measured = values > values[-1] * 1e-4
    basis = vectors[:, is_measured]
    estimate = [likelihood.estimate_rate(term, level, basis, v) for likelihood, term, level in terms]
    means = np.array([mean for mean, _, _ in estimate])
    centre = np.average(means, axis=0, weights=weight)
    between = np.einsum("k,ki,kj->ij", weight, means - centre, means - centre)
    spread = np.average([one for _, one, _ in estimate], axis=0, weights=weight)
    angles = np.average([one for *_, one in estimate], axis=0, weights=weight)
    if len(likelihoods) > 1:
        # The variation between scale errors is attributed to the angles; a small part of it is from the
        # drift.
        angles, between = angles + between, np.zeros_like(between)
    covariance = basis @ (spread + between + angles) @ basis.T
    if not is_measured.all():
        covariance = covariance + UNMEASURED_VARIANCE * np.outer(vectors[:, 0], vectors[:, 0])
    return basis @ centre, covariance, basis @ angles @ basis.T


def _noise_ratios(drift: DriftNoise, mean: float) -> NoiseRatios:
    n = drift.n**2
    return drift.b**2 * mean / n, drift.k**2 * mean**2 / n, drift.q**2 / (n * mean)


def _scale_to_record(
    pieces: Sequence[Averages], drift: DriftNoise, horizontal: float, freedom: int, mean: float, order: int
) -> DriftNoise:
    """Return the given drift, scaled up if the record has significantly more noise."""
    (term,) = sufficient_statistics(pieces, [_noise_ratios(drift, mean)], mean, order=order)
    estimate = _ScaleLikelihood([term], horizontal, freedom, None).estimate_level(term)
    variance_ratio = estimate * mean / drift.n**2
    if variance_ratio < 1 + _EXCESS_NOISE_SIGMA * np.sqrt(2 / max(freedom, 1)):
        return drift
    factor = float(np.sqrt(variance_ratio))
    return DriftNoise(factor * drift.n, factor * drift.b, factor * drift.k, factor * drift.q)


def _select_trend(pieces: Sequence[Averages], horizontal: float, mean: float) -> tuple[list[Averages], int]:
    """Return the pieces, without temperatures that explain nothing, and RAMP_ORDER or BEND_ORDER.

    A curve, or the temperature, must explain significantly more than any drift. Uses the unrestricted
    likelihood, because restricted likelihoods of different nuisances are not comparable.
    """
    plain = _without_temperature(pieces)
    ramp = _best_fit(plain, horizontal, mean, RAMP_ORDER)
    is_warm = all(p.temperature is not None and np.ptp(p.temperature) > _MIN_WARMTH for p in pieces)
    if is_warm and _best_fit(pieces, horizontal, mean, RAMP_ORDER) > ramp + _MIN_BEND_GAIN * len(pieces):
        plain, ramp = list(pieces), _best_fit(pieces, horizontal, mean, RAMP_ORDER)
    bend = _best_fit(plain, horizontal, mean, BEND_ORDER)
    return plain, BEND_ORDER if bend > ramp + _MIN_BEND_GAIN * len(pieces) else RAMP_ORDER


def _without_temperature(pieces: Sequence[Averages]) -> list[Averages]:
    return [replace(piece, temperature=None) for piece in pieces]


def _best_fit(pieces: Sequence[Averages], horizontal: float, mean: float, order: int) -> float:
    """Return the largest log likelihood over drifts and azimuths, not restricted."""
    count = sum(len(p.y) for p in pieces)
    grid = [(f, w, 0.0) for f in _COARSE_FLICKER_RATIOS for w in WALK_RATIOS]
    terms = sufficient_statistics(pieces, grid, mean, order=order)
    likelihood = _ScaleLikelihood(terms, horizontal, count, None)
    plain = np.array([0.5 * (term.logdet - term.unrestricted_logdet) for term in terms])
    return float((likelihood.log_density(_COARSE_AZIMUTHS) + plain[:, None]).max())


def _select_vibration(
    pieces: Sequence[Averages], horizontal: float, freedom: int, mean: float, order: int
) -> float:
    """Return the most likely of SHAKE_RATIOS on a coarse drift grid, or 0 if none is significantly better."""
    best = []
    for vibration in SHAKE_RATIOS:
        grid = [(f, w, vibration) for f in _COARSE_FLICKER_RATIOS for w in _COARSE_WALK_RATIOS]
        likelihood = _ScaleLikelihood(
            sufficient_statistics(pieces, grid, mean, order=order), horizontal, freedom, None
        )
        best.append(float(likelihood.log_density(_COARSE_AZIMUTHS).max()))
    best_drift = int(np.argmax(best))
    return SHAKE_RATIOS[best_drift] if best[best_drift] > best[0] + _MIN_VIBRATION_GAIN else 0.0


def _refine_grid(
    log_density: Callable[[Array], Array], azimuth: Array, density: Array
) -> tuple[Array, Array]:
    """Return azimuths, rad, and density on a finer grid about the peak if it is narrower than the grid."""
    if (density > density.max() * 1e-3).sum() >= 60:
        return azimuth, density
    width = max(int((density > density.max() * 1e-6).sum()), 2) * np.radians(0.25)
    for _ in range(6):
        centre = float(azimuth[density.argmax()])
        azimuth = centre + np.linspace(-width, width, 801)
        refined = log_density(azimuth)
        density = np.exp(refined - refined.max()).sum(axis=0)
        resolved = np.count_nonzero(density > density.max() * 1e-6)
        if resolved > 100:
            break
        width = max(width * resolved / 400, 1e-9)
    return azimuth, density


def _drift_from_ratios(
    term: SufficientStatistics, ratios: NoiseRatios, freedom: int, mean: float
) -> DriftNoise:
    """Return N, B, K, Q of a grid point from its ratios and the residuals of its best C and S."""
    gram, score = term.gram[:2, :2], term.gram[:2, 4]
    estimate = np.linalg.lstsq(gram, score, rcond=1e-9)[0]
    level = max(float(term.gram[4, 4] - score @ estimate), 1e-300) / max(1, freedom - 2) * mean
    f, w, q = (float(np.sqrt(ratio * level)) for ratio in ratios)
    return DriftNoise(float(np.sqrt(level)), f / float(np.sqrt(mean)), w / mean, q * float(np.sqrt(mean)))
