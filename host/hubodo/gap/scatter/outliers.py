"""Outliers: isolated readings far from their neighbours, more of them than Gaussian noise produces."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import chdtrc, erfc, expit, logit, logsumexp

from hubodo.arrays import Array
from hubodo.effects import BY_NAME
from hubodo.gap.process_noise.residual import Residual
from hubodo.gap.scatter.base import Proposal, group_by_scope, remove_rounding
from hubodo.gap.state.terms import ModelTerm

EFFECT_NAME = "outliers"
_OUTLIER_SIGMAS = np.geomspace(2.5, 100.0, 40)
_OUTLIER_SHARES = np.geomspace(1e-5, 0.3, 40)
# Gain of ln likelihood from which on spikes of one channel are reported.
_MIN_SPIKE_GAIN = 15.0
# Evidence deducted because sensor noise is never exactly Gaussian.
_NON_GAUSSIAN_PENALTY = 2.0
_OUTLYING_SIGMA, _ISOLATED_SIGMA, _MIN_UNIFORM_P_VALUE = 5.0, 4.5, 1e-5
# Ratio of the noise of two groups from which on the noise varies within groups, too, and so has a tail; the
# ratio of the tail's sigma to the noise, and its share to start with.
_MIN_VARYING_RATIO, _TAIL_RATIO, _TAIL_SHARE = 1.5, 3.0, 0.02
# Step of the logarithms of share and sigma in numerical derivatives.
_HESSIAN_STEP = 0.02
# Largest share of the outliers that may come close together; bumps of a road come in bursts.
_MAX_CLOSE_SHARE = 0.12


@dataclass(frozen=True)
class _Channel:
    """New readings of one channel in use; repeated samples are left out.

    row: index of the channel
    z: (n,) readings relative to their neighbours, in sigma
    groups: (n,) index of the group of similar noise of each reading
    declared_sigmas: (G,), the declared noise in each group, in the unit of `z`
    """

    row: int
    z: Array
    groups: Array
    declared_sigmas: Array

    def is_outlying(self, sigmas: float) -> NDArray[np.bool_]:
        """Return which readings, (n,), are beyond `sigmas` of the noise, and beyond 1 declared sigma.

        Where a sensor is much quieter than declared, such as at standstill, a start of the motor is beyond
        many sigmas of that noise, for several readings in a row, and yet smaller than the declared noise.
        """
        return np.asarray(np.abs(self.z) > np.maximum(sigmas, self.declared_sigmas[self.groups]))

    def count_visible(self, sigma: float) -> float:
        """Return how many of the readings would be outlying if all had outliers of a declared size."""
        limits = np.maximum(_OUTLYING_SIGMA, self.declared_sigmas)
        sizes = np.hypot(1.0, sigma * self.declared_sigmas)
        return float(np.bincount(self.groups, minlength=len(limits)) @ erfc(limits / sizes / math.sqrt(2.0)))


@dataclass(frozen=True)
class _NodeOutliers:
    """Outlier statistics of one node.

    channels: channels in use
    gain_tables: gain of ln likelihood of each channel, by outlier share and sigma
    count: number of readings
    is_random: True if outliers come at random times and channels
    """

    channels: Sequence[_Channel]
    gain_tables: Sequence[Array]
    count: int
    is_random: bool

    @property
    def has_tail(self) -> bool:
        """Return True if the noise varies so much that it has a tail within its groups."""
        ratios = [one.declared_sigmas.max() / one.declared_sigmas.min() for one in self.channels]
        return max(ratios, default=1.0) > _MIN_VARYING_RATIO


def detect_outliers(residuals: Sequence[Residual]) -> list[Proposal]:
    """Detect outliers by maximum likelihood of a mixture of the noise and a wider Gaussian."""
    statistics = {
        entry.node.name: _examine_node(entry)
        for entry in residuals
        if BY_NAME[EFFECT_NAME] not in entry.effects
    }
    proposals = []
    for scope, members in group_by_scope([entry for entry in residuals if entry.node.name in statistics]):
        members_statistics = [statistics[entry.node.name] for entry in members]
        table = np.sum([part for entry in members_statistics for part in entry.gain_tables], axis=0)
        count = sum(entry.count for entry in members_statistics)
        best = np.unravel_index(int(np.argmax(table)), table.shape)
        gain = float(table[best])
        if gain < 3.0 or not all(entry.is_random for entry in members_statistics):
            continue
        share, sigma = float(_OUTLIER_SHARES[best[0]]), float(_OUTLIER_SIGMAS[best[1]])
        has_tail = all(entry.has_tail for entry in members_statistics)
        channels = [one for entry in members_statistics for one in entry.channels]
        mixture = _fit_mixture(channels, share, sigma, has_tail)
        share, sigma = mixture.share, mixture.sigma
        if has_tail and sigma < _OUTLIER_SIGMAS[0]:
            # Errors no larger than the declared noise are another part of the tail, not outliers.
            continue
        expected_outliers = max(share * count, 1.0)
        term = ModelTerm(BY_NAME[EFFECT_NAME](probability=share, sigma=sigma), scope)  # type: ignore[call-arg]
        sigmas = {"probability": mixture.share_error, "sigma": mixture.sigma_error}
        where = f"about {expected_outliers:.0f} isolated readings, {sigma:.0f} times wider than the noise"
        # Uniform prior over the grid of shares and sigmas.
        evidence = float(logsumexp(table)) - math.log(table.size) - _NON_GAUSSIAN_PENALTY
        proposals.append(Proposal(term, gain, evidence, sigmas, where))
    return proposals


def find_spiky_channels(residual: Residual) -> list[tuple[int, int, float]]:
    """Return channels with outliers that the other channels lack: row, number and median size in sigma."""
    node = _examine_node(residual)
    if node.is_random:
        return []
    spiky = []
    for channel, table in zip(node.channels, node.gain_tables, strict=True):
        if np.max(table) > _MIN_SPIKE_GAIN:
            z = np.abs(channel.z)
            outliers = z[z > 6.0]
            if len(outliers):
                spiky.append((channel.row, len(outliers), float(np.median(outliers))))
    return spiky


def _examine_node(residual: Residual) -> _NodeOutliers:
    channels = _standardise_channels(residual)
    tables = [_gain_table(one) for one in channels]
    total = np.sum(tables, axis=0)
    sigma = float(_OUTLIER_SIGMAS[np.argmax(total) % len(_OUTLIER_SIGMAS)]) if channels else 1.0
    is_random = _are_uniform(channels, sigma) and _are_isolated(channels)
    return _NodeOutliers(channels, tables, sum(len(one.z) for one in channels), is_random)


def _standardise_channels(residual: Residual) -> list[_Channel]:
    """Return each channel in use less the median of neighbouring samples, which removes bursts of misfit."""
    result = []
    for row in np.flatnonzero(residual.node.used).tolist():
        is_used = residual.noise.is_new & ~residual.node.is_saturated[row]
        noise = residual.noise.channel_sigma(row)
        z = (remove_rounding(residual, row) / noise)[is_used]
        z = z - _neighbour_median(z)
        sigma = max(float(np.median(np.abs(z))) / 0.6745, 1e-9)
        # Differences include the neighbours' noise, and noise differs from the declared one.
        declared = (residual.declared_channel_sigma(row) / noise)[is_used] / sigma
        groups = residual.noise.group_indices[is_used].astype(np.intp)
        sizes = np.maximum(np.bincount(groups), 1)
        result.append(_Channel(row, z / sigma, groups, np.bincount(groups, declared) / sizes))
    return result


def _are_uniform(channels: Sequence[_Channel], sigma: float) -> bool:
    """Return True if outliers are as frequent in all channels as those of one size would be (G-test).

    sigma: of the outliers, in units of the declared noise

    In a channel that is quieter than declared, more of them are beyond the limit.
    """
    counts = np.array([int(one.is_outlying(_OUTLYING_SIGMA).sum()) for one in channels])
    total = int(counts.sum())
    if total < 8 or len(counts) < 2:
        return True
    visible = np.array([one.count_visible(sigma) for one in channels])
    expected = np.maximum(visible, 1e-9) * total / max(float(visible.sum()), 1e-9)
    is_hit = counts > 0
    statistic = 2.0 * float(np.sum(counts[is_hit] * np.log(counts[is_hit] / expected[is_hit])))
    return bool(chdtrc(len(counts) - 1, max(statistic, 0.0)) > _MIN_UNIFORM_P_VALUE)


def _are_isolated(channels: Sequence[_Channel]) -> bool:
    """Return True if outliers come one by one, hardly more of them close together than expected by chance."""
    close, hits, total = 0, 0, 0
    for one in channels:
        is_outlier = one.is_outlying(_ISOLATED_SIGMA)
        hits, total = hits + int(is_outlier.sum()), total + len(is_outlier)
        close += int((is_outlier[2:] & is_outlier[:-2]).sum()) + int((is_outlier[3:] & is_outlier[:-3]).sum())
    expected = 2.0 * hits * hits / max(total, 1)
    return bool(close < 3.0 * expected + 4.0 * np.sqrt(expected) + 4.0 + _MAX_CLOSE_SHARE * hits)


def _gain_table(one: _Channel) -> Array:
    """Return the gain of ln likelihood of a channel, (40, 40), by outlier share and sigma.

    Outliers have one size in units of the declared noise, so that in a quiet group they are many times as
    wide as its noise, and in a rough one hardly wider.
    """
    total = np.zeros((len(_OUTLIER_SHARES), len(_OUTLIER_SIGMAS)))
    for z, counts, declared in _count_by_group(one):
        total += _group_gains(z, counts, _OUTLIER_SIGMAS * declared)
    return total


def _count_by_group(one: _Channel) -> Iterator[tuple[Array, Array, float]]:
    """Yield |z|, how often it occurs, and the declared sigma in its unit, of each group of a channel."""
    edges = np.concatenate([np.linspace(0.0, 6.0, 121), np.geomspace(6.2, 4000.0, 150)])
    middle = 0.5 * (edges[1:] + edges[:-1])
    bins = np.minimum(np.searchsorted(edges, np.abs(one.z), "right") - 1, len(middle) - 1)
    for group, declared in enumerate(one.declared_sigmas):
        counts = np.bincount(bins[one.groups == group], minlength=len(middle))
        if counts.any():
            yield middle[counts > 0], counts[counts > 0].astype(float), float(declared)


@dataclass(frozen=True)
class _Mixture:
    """Share and sigma of outliers, in units of the declared noise, with 1 sigma of each."""

    share: float
    sigma: float
    share_error: float
    sigma_error: float


def _fit_mixture(channels: Sequence[_Channel], share: float, sigma: float, has_tail: bool) -> _Mixture:
    """Return the mixture of largest likelihood; its errors are those of the observed information.

    share, sigma: to start with
    has_tail: True to fit the share of a tail of the noise as well

    On a road the noise varies within each second, so that its own tail would count as small outliers. How
    many small outliers there are remains uncertain then.
    """
    groups = [group for one in channels for group in _count_by_group(one)]
    z, counts = (np.concatenate([group[k] for group in groups]) for k in (0, 1))
    declared = np.repeat([group[2] for group in groups], [len(group[0]) for group in groups])
    narrow, tail = np.exp(-0.5 * z**2), np.exp(-0.5 * (z / _TAIL_RATIO) ** 2) / _TAIL_RATIO

    def loss(x: Array) -> float:
        outliers, tail_share = expit(x[0]), expit(x[2]) if has_tail else 0.0
        variance = 1.0 + (np.exp(x[1]) * declared) ** 2
        noise = (1.0 - tail_share) * narrow + tail_share * tail
        density = (1.0 - outliers) * noise + outliers * np.exp(-0.5 * z**2 / variance) / np.sqrt(variance)
        return -float(counts @ np.log(np.maximum(density, 1e-300)))

    start = [logit(share), np.log(sigma), *([logit(_TAIL_SHARE)] if has_tail else [])]
    best = minimize(loss, start, method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-2}).x
    errors = np.sqrt(np.maximum(np.diag(np.linalg.pinv(_compute_hessian(loss, best), hermitian=True)), 0.0))
    share, sigma = float(expit(best[0])), float(np.exp(best[1]))
    return _Mixture(share, sigma, share * (1.0 - share) * float(errors[0]), sigma * float(errors[1]))


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
    shares = _OUTLIER_SHARES[:, None]
    width = 1.0 / np.sqrt(1.0 + outlier_sigmas[:, None] ** 2)
    density = shares[:, None] * (width * np.exp(-0.5 * (z * width) ** 2))
    density += ((1.0 - shares) * np.exp(-0.5 * z**2))[:, None]
    # In place, because the array of all shares, sigmas and readings is large.
    np.log(np.maximum(density, 1e-300, out=density), out=density)
    return np.asarray(density @ counts - noise_only)


def _neighbour_median(z: Array) -> Array:
    """Return the median of the two samples before and the two after each."""
    padded = np.pad(z, 2, mode="reflect")
    around = np.stack([padded[:-4], padded[1:-3], padded[3:-1], padded[4:]])
    around.sort(axis=0)
    return np.asarray(0.5 * (around[1] + around[2]))
