"""Mixture of the noise of a channel and a wider Gaussian: its likelihood, and its most likely parameters."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import erfc, expit, logit

from hubodo.arrays import Array

OUTLIER_SIGMAS = np.geomspace(2.5, 100.0, 40)
OUTLIER_SHARES = np.geomspace(1e-5, 0.3, 40)
# Sigmas of the noise beyond which a reading is outlying where all that are outlying are counted.
OUTLYING_SIGMA = 5.0
# Sigma of the tail of the noise relative to the noise, and its share, to start with.
_TAIL_RATIO, _TAIL_SHARE = 2.0, 0.02
# Logarithms of the noise of a channel relative to its estimate by the median.
_NOISE_SCALES = np.linspace(-0.08, 0.08, 17)
# Step of the logarithms of share and sigma in numerical derivatives.
_HESSIAN_STEP = 0.02


@dataclass(frozen=True)
class Channel:
    """New readings of one channel in use; repeated samples are left out.

    row: index of the channel
    samples: (n,) samples of the node
    z: (n,) readings relative to their neighbours, in sigma
    groups: (n,) index of the group of similar noise of each reading
    declared_sigmas: (G,), the declared noise in each group, in the unit of `z`
    """

    row: int
    samples: NDArray[np.intp]
    z: Array
    groups: Array
    declared_sigmas: Array

    def is_outlying(self, sigmas: float) -> NDArray[np.bool_]:
        """Return which readings, (n,), are beyond `sigmas` of the noise, and beyond 1 declared sigma.

        Where a sensor is much quieter than declared, such as at standstill, a start of the motor is beyond
        many sigmas of that noise, for several readings in a row, and yet smaller than the declared noise.
        """
        return np.asarray(np.abs(self.z) > np.maximum(sigmas, self.declared_sigmas[self.groups]))

    def select(self, mask: NDArray[np.bool_]) -> Channel:
        """Return a copy with some of the readings; mask: (n,)."""
        return replace(self, samples=self.samples[mask], z=self.z[mask], groups=self.groups[mask])

    def count_visible(self, sigma: float) -> float:
        """Return how many of the readings would be outlying if all had outliers of a declared size."""
        limits = np.maximum(OUTLYING_SIGMA, self.declared_sigmas)
        sizes = np.hypot(1.0, sigma * self.declared_sigmas)
        return float(np.bincount(self.groups, minlength=len(limits)) @ erfc(limits / sizes / math.sqrt(2.0)))


def compute_gain_table(one: Channel) -> Array:
    """Return the gain of ln likelihood of a channel, (40, 40), by outlier share and sigma.

    Outliers have one size in units of the declared noise, so that in a quiet group they are many times as
    wide as its noise, and in a rough one hardly wider.
    """
    total = np.zeros((len(OUTLIER_SHARES), len(OUTLIER_SIGMAS)))
    for z, counts, declared in _count_by_group(one):
        total += _group_gains(z, counts, OUTLIER_SIGMAS * declared)
    return total


def _count_by_group(one: Channel) -> Iterator[tuple[Array, Array, float]]:
    """Yield |z|, how often it occurs, and the declared sigma in its unit, of each group of a channel."""
    edges = np.concatenate([np.linspace(0.0, 6.0, 121), np.geomspace(6.2, 4000.0, 150)])
    middle = 0.5 * (edges[1:] + edges[:-1])
    bins = np.minimum(np.searchsorted(edges, np.abs(one.z), "right") - 1, len(middle) - 1)
    for group, declared in enumerate(one.declared_sigmas):
        counts = np.bincount(bins[one.groups == group], minlength=len(middle))
        if counts.any():
            yield middle[counts > 0], counts[counts > 0].astype(float), float(declared)


@dataclass(frozen=True)
class Mixture:
    """Share and sigma of outliers, in units of the declared noise, with 1 sigma of each."""

    share: float
    sigma: float
    share_error: float
    sigma_error: float


def fit_mixture(channels: Sequence[Channel], share: float, sigma: float, has_tail: bool) -> Mixture:
    """Return the mixture of largest likelihood; its errors are those of the observed information.

    share, sigma: to start with
    has_tail: True to fit share and size of a tail of the noise as well

    On a road the noise varies within each second, so that its own tail would count as small outliers. How
    many small outliers there are remains uncertain then. The noise of each channel is fitted as well: a
    median that is 1 % too large, as outliers make it, would hide a fifth of the small ones.
    """
    groups = [list(_count_by_group(one)) for one in channels]
    z, counts = (np.concatenate([part[k] for own in groups for part in own]) for k in (0, 1))
    declared = np.concatenate([np.full(len(part[0]), part[2]) for own in groups for part in own])
    starts = np.cumsum([0, *(sum(len(part[0]) for part in own) for own in groups)])[:-1]
    squares, scales = z**2, np.exp(_NOISE_SCALES)[:, None]
    narrow = np.exp(-0.5 * squares / scales**2) / scales

    def loss(x: Array) -> float:
        outliers, variance, noise = expit(x[0]), scales**2 + (np.exp(x[1]) * declared) ** 2, narrow
        if has_tail:
            wide, tail_share = (1.0 + np.exp(x[3])) * scales, expit(x[2])
            noise = (1.0 - tail_share) * narrow + tail_share * np.exp(-0.5 * squares / wide**2) / wide
        density = (1.0 - outliers) * noise
        density += outliers * np.exp(-0.5 * squares / variance) / np.sqrt(variance)
        losses = -np.add.reduceat(np.log(np.maximum(density, 1e-300)) * counts, starts, axis=1)
        return float(sum(_find_minimum(losses.T)))

    start = [logit(share), np.log(sigma)]
    if has_tail:
        start += [logit(_TAIL_SHARE), np.log(_TAIL_RATIO - 1.0)]
    best = minimize(loss, start, method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-2}).x
    errors = np.sqrt(np.maximum(np.diag(np.linalg.pinv(_compute_hessian(loss, best), hermitian=True)), 0.0))
    share, sigma = float(expit(best[0])), float(np.exp(best[1]))
    return Mixture(share, sigma, share * (1.0 - share) * float(errors[0]), sigma * float(errors[1]))


def _find_minimum(curves: Array) -> Array:
    """Return the minimum of each curve, (C, S), at equal steps, by a parabola through the lowest points."""
    lowest = np.clip(np.argmin(curves, axis=1), 1, curves.shape[1] - 2)[:, None]
    before, at, after = (np.take_along_axis(curves, lowest + k, axis=1)[:, 0] for k in (-1, 0, 1))
    curvature, slope = before - 2.0 * at + after, 0.5 * (after - before)
    shift = np.clip(-slope / np.maximum(curvature, 1e-12), -1.0, 1.0)
    return np.asarray(at + slope * shift + 0.5 * curvature * shift**2)


def _compute_hessian(function: Callable[[Array], float], at: Array) -> Array:
    """Return the second derivatives, (k, k), of a function by central differences."""
    steps = _HESSIAN_STEP * np.eye(len(at))
    return np.array(
        [
            [
                function(at + a + b) - function(at + a - b) - function(at - a + b) + function(at - a - b)
                for b in steps
            ]
            for a in steps
        ]
    ) / (4.0 * _HESSIAN_STEP**2)


def _group_gains(z: Array, counts: Array, outlier_sigmas: Array) -> Array:
    """Return the gain of readings of one noise level, (40, 40), over noise alone with a free scale.

    z, counts: (m,) absolute values and their numbers; outlier_sigmas: (40,), in the unit of `z`
    """
    scales = np.linspace(0.9, 1.3, 21)[:, None]
    noise_only = float(np.max(np.sum(counts * (-0.5 * (z / scales) ** 2 - np.log(scales)), axis=1)))
    shares = OUTLIER_SHARES[:, None]
    width = 1.0 / np.sqrt(1.0 + outlier_sigmas[:, None] ** 2)
    density = shares[:, None] * (width * np.exp(-0.5 * (z * width) ** 2))
    density += ((1.0 - shares) * np.exp(-0.5 * z**2))[:, None]
    # In place, because the array of all shares, sigmas and readings is large.
    np.log(np.maximum(density, 1e-300, out=density), out=density)
    return np.asarray(density @ counts - noise_only)
