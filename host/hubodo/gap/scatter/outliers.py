"""Outliers: isolated readings far from their neighbours, more of them than Gaussian noise produces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import log

import numpy as np
from scipy.special import chdtrc, logsumexp

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
_OUTLYING_SIGMA, _MIN_UNIFORM_P_VALUE = 5.0, 1e-5
# Largest share of the outliers that may come close together; bumps of a road come in bursts.
_MAX_CLOSE_SHARE = 0.12


@dataclass(frozen=True)
class _Channel:
    """New readings of one channel in use; repeated samples are left out.

    row: index of the channel
    z: (n,) readings relative to their neighbours, in sigma
    sigma: their 1 sigma, in units of the channel's estimated noise
    """

    row: int
    z: Array
    sigma: float


@dataclass(frozen=True)
class _NodeOutliers:
    """Outlier statistics of one node.

    gain_tables: gain of ln likelihood of each channel, by outlier share and sigma
    count: number of readings
    is_random: True if outliers come at random times and channels
    """

    gain_tables: Sequence[Array]
    count: int
    is_random: bool


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
        expected_outliers = max(share * count, 1.0)
        term = ModelTerm(BY_NAME[EFFECT_NAME](probability=share, sigma=sigma), scope)  # type: ignore[call-arg]
        sigmas = {
            "probability": share / np.sqrt(expected_outliers),
            "sigma": sigma / np.sqrt(2.0 * expected_outliers),
        }
        where = f"about {expected_outliers:.0f} isolated readings, {sigma:.0f} times wider than the noise"
        # Uniform prior over the grid of shares and sigmas.
        evidence = float(logsumexp(table)) - log(table.size) - _NON_GAUSSIAN_PENALTY
        proposals.append(Proposal(term, gain, evidence, sigmas, where))
    return proposals


def find_spiky_channels(residual: Residual) -> list[tuple[int, int, float]]:
    """Return channels with outliers that the other channels lack: row, number and median size in sigma."""
    channels = _standardise_channels(residual)
    if _are_uniform(channels) and _are_isolated(channels):
        return []
    spiky = []
    for channel in channels:
        if np.max(_gain_table(residual, channel)) > _MIN_SPIKE_GAIN:
            z = np.abs(channel.z)
            outliers = z[z > 6.0]
            if len(outliers):
                spiky.append((channel.row, len(outliers), float(np.median(outliers))))
    return spiky


def _examine_node(residual: Residual) -> _NodeOutliers:
    channels = _standardise_channels(residual)
    tables = [_gain_table(residual, one) for one in channels]
    return _NodeOutliers(
        tables, sum(len(one.z) for one in channels), _are_uniform(channels) and _are_isolated(channels)
    )


def _standardise_channels(residual: Residual) -> list[_Channel]:
    """Return each channel in use less the median of neighbouring samples, which removes bursts of misfit."""
    result = []
    for row in np.flatnonzero(residual.node.used).tolist():
        is_used = residual.noise.is_new & ~residual.node.is_saturated[row]
        z = (remove_rounding(residual, row) / residual.noise.channel_sigma(row))[is_used]
        z = z - _neighbour_median(z)
        sigma = max(float(np.median(np.abs(z))) / 0.6745, 1e-9)
        result.append(_Channel(row, z / sigma, sigma))
    return result


def _are_uniform(channels: Sequence[_Channel]) -> bool:
    """Return True if outliers are equally frequent in all channels (G-test)."""
    counts = np.array([int((np.abs(one.z) > _OUTLYING_SIGMA).sum()) for one in channels])
    total = int(counts.sum())
    if total < 8 or len(counts) < 2:
        return True
    positive = counts[counts > 0]
    statistic = 2.0 * float(np.sum(positive * np.log(positive * len(counts) / total)))
    return bool(chdtrc(len(counts) - 1, max(statistic, 0.0)) > _MIN_UNIFORM_P_VALUE)


def _are_isolated(channels: Sequence[_Channel]) -> bool:
    """Return True if outliers come one by one, hardly more of them close together than expected by chance."""
    close, hits, total = 0, 0, 0
    for one in channels:
        is_outlier = np.abs(one.z) > 4.5
        hits, total = hits + int(is_outlier.sum()), total + len(is_outlier)
        close += int((is_outlier[2:] & is_outlier[:-2]).sum()) + int((is_outlier[3:] & is_outlier[:-3]).sum())
    expected = 2.0 * hits * hits / max(total, 1)
    return bool(close < 3.0 * expected + 4.0 * np.sqrt(expected) + 4.0 + _MAX_CLOSE_SHARE * hits)


def _gain_table(residual: Residual, one: _Channel) -> Array:
    """Return the gain of ln likelihood of a channel, (40, 40), by outlier share and sigma."""
    edges = np.concatenate([np.linspace(0.0, 6.0, 121), np.geomspace(6.2, 400.0, 100)])
    counts, _ = np.histogram(np.minimum(np.abs(one.z), 399.0), edges)
    middle = 0.5 * (edges[1:] + edges[:-1])
    counts, middle = counts[counts > 0], middle[counts > 0]
    # Likelihood of the noise alone, with a free scale.
    scales = np.linspace(0.9, 1.3, 21)[:, None]
    noise_only = float(np.max(np.sum(counts * (-0.5 * (middle / scales) ** 2 - np.log(scales)), axis=1)))
    # Differences include the neighbours' noise, and noise may differ from the declared one.
    declared = float(
        np.mean(residual.declared_channel_sigma(one.row) / residual.noise.channel_sigma(one.row))
    )
    relative_sigma = _OUTLIER_SIGMAS * declared / one.sigma
    total = np.zeros((len(_OUTLIER_SHARES), len(_OUTLIER_SIGMAS)))
    inverse_width = 1.0 / np.sqrt(1.0 + relative_sigma**2)
    narrow = np.exp(-0.5 * middle**2)
    for j, share in enumerate(inverse_width):
        wide_density = share * np.exp(-0.5 * (middle * share) ** 2)
        mixed = (1.0 - _OUTLIER_SHARES[:, None]) * narrow + _OUTLIER_SHARES[:, None] * wide_density
        total[:, j] = np.log(np.maximum(mixed, 1e-300)) @ counts - noise_only
    return total


def _neighbour_median(z: Array) -> Array:
    """Return the median of the two samples before and the two after each."""
    padded = np.pad(z, 2, mode="reflect")
    around = np.stack([padded[:-4], padded[1:-3], padded[3:-1], padded[4:]])
    around.sort(axis=0)
    return np.asarray(0.5 * (around[1] + around[2]))
