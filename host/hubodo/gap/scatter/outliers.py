"""Outliers: isolated readings far from their neighbours, more of them than Gaussian noise produces."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, logsumexp

from hubodo.arrays import Array
from hubodo.effects import BY_NAME
from hubodo.gap.process_noise.residual import Residual
from hubodo.gap.scatter.base import Proposal, group_by_scope, remove_rounding
from hubodo.gap.scatter.outlier_mixture import (
    OUTLIER_SHARES,
    OUTLIER_SIGMAS,
    OUTLYING_SIGMA,
    Channel,
    compute_gain_table,
    fit_mixture,
)
from hubodo.gap.state.terms import ModelTerm

EFFECT_NAME = "outliers"
# Gain of ln likelihood from which on spikes of one channel are reported.
_MIN_SPIKE_GAIN = 15.0
# Evidence deducted because sensor noise is never exactly Gaussian.
_NON_GAUSSIAN_PENALTY = 2.0
_MIN_UNIFORM_P_VALUE = 1e-5
# Ratio of the noise of two groups from which on the noise varies within groups, too, and so has a tail.
_MIN_VARYING_RATIO = 1.5
# Bumps of a road come in bursts: this many readings of all channels beyond some sigmas, or two of the same
# channel, within some samples of each other.
_BURST_SIGMA, _BURST_SAMPLES, _MIN_BURST_COUNT = 4.5, 3, 3
# Number of readings close together that are no burst even if none is expected.
_MAX_CLOSE_BY_CHANCE = 2.0


@dataclass(frozen=True)
class _NodeOutliers:
    """Outlier statistics of one node.

    channels: channels in use
    gain_tables: gain of ln likelihood of each channel, by outlier share and sigma
    count: number of readings
    is_random: True if outliers are as frequent in all channels
    """

    channels: Sequence[Channel]
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
        share, sigma = float(OUTLIER_SHARES[best[0]]), float(OUTLIER_SIGMAS[best[1]])
        has_tail = all(entry.has_tail for entry in members_statistics)
        channels = [one for entry in members_statistics for one in entry.channels]
        mixture = fit_mixture(channels, share, sigma, has_tail)
        share, sigma = mixture.share, mixture.sigma
        if sigma < (OUTLIER_SIGMAS[0] if has_tail else 1.0):
            # Errors no larger than the noise are another part of its tail, not outliers.
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
    if not _are_isolated(channels):
        channels = _remove_bursts(channels)
    tables = [compute_gain_table(one) for one in channels]
    total = np.sum(tables, axis=0)
    sigma = float(OUTLIER_SIGMAS[np.argmax(total) % len(OUTLIER_SIGMAS)]) if channels else 1.0
    count = sum(len(one.z) for one in channels)
    return _NodeOutliers(channels, tables, count, _are_uniform(channels, sigma))


def _standardise_channels(residual: Residual) -> list[Channel]:
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
        declared_sigmas = np.bincount(groups, declared) / sizes
        result.append(Channel(row, np.flatnonzero(is_used), z / sigma, groups, declared_sigmas))
    return result


def _are_isolated(channels: Sequence[Channel]) -> bool:
    """Return True if outliers come one by one, no more of them close together than expected by chance."""
    close, hits, total = 0, 0, 0
    for one in channels:
        is_outlier = one.is_outlying(_BURST_SIGMA)
        hits, total = hits + int(is_outlier.sum()), total + len(is_outlier)
        close += int((is_outlier[2:] & is_outlier[:-2]).sum()) + int((is_outlier[3:] & is_outlier[:-3]).sum())
    expected = 2.0 * hits * hits / max(total, 1)
    return bool(close < expected + 3.0 * np.sqrt(expected) + _MAX_CLOSE_BY_CHANCE)


def _remove_bursts(channels: Sequence[Channel]) -> list[Channel]:
    """Return the channels without the readings near bursts of outlying ones, which are bumps of a road."""
    length = 1 + max((int(one.samples[-1]) for one in channels if len(one.samples)), default=0)
    total, is_burst = np.zeros(length), np.zeros(length, np.bool_)
    for one in channels:
        hits = np.zeros(length)
        hits[one.samples] = one.is_outlying(_BURST_SIGMA)
        is_burst |= (hits > 0.0) & (_count_near(hits) > 1)
        total += hits
    is_burst |= (total > 0.0) & (_count_near(total) >= _MIN_BURST_COUNT)
    is_regular = _count_near(is_burst) == 0
    return [one.select(is_regular[one.samples]) for one in channels]


def _count_near(hits: Array | NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the number of hits, (N,), within a few samples of each."""
    total = np.concatenate([np.zeros(_BURST_SAMPLES + 1), np.cumsum(hits, dtype=float)])
    total = np.append(total, np.full(_BURST_SAMPLES, total[-1]))
    width = 2 * _BURST_SAMPLES + 1
    return np.asarray(np.rint(total[width:] - total[:-width])).astype(np.intp)


def _are_uniform(channels: Sequence[Channel], sigma: float) -> bool:
    """Return True if outliers are as frequent in all channels as those of one size would be (G-test).

    sigma: of the outliers, in units of the declared noise

    In a channel that is quieter than declared, more of them are beyond the limit.
    """
    counts = np.array([int(one.is_outlying(OUTLYING_SIGMA).sum()) for one in channels])
    total = int(counts.sum())
    if total < 8 or len(counts) < 2:
        return True
    visible = np.array([one.count_visible(sigma) for one in channels])
    expected = np.maximum(visible, 1e-9) * total / max(float(visible.sum()), 1e-9)
    is_hit = counts > 0
    statistic = 2.0 * float(np.sum(counts[is_hit] * np.log(counts[is_hit] / expected[is_hit])))
    return bool(chdtrc(len(counts) - 1, max(statistic, 0.0)) > _MIN_UNIFORM_P_VALUE)


def _neighbour_median(z: Array) -> Array:
    """Return the median of the two samples before and the two after each."""
    padded = np.pad(z, 2, mode="reflect")
    around = np.stack([padded[:-4], padded[1:-3], padded[3:-1], padded[4:]])
    around.sort(axis=0)
    return np.asarray(0.5 * (around[1] + around[2]))
