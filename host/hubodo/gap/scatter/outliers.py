"""Outliers: lonely readings far from their neighbours, more than Gaussian noise makes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import log

import numpy as np
from scipy.special import chdtrc, logsumexp

from hubodo.arrays import Array
from hubodo.effects import BY_NAME
from hubodo.gap.process_noise.residual import Residual
from hubodo.gap.scatter.base import Proposal, shared, unrounded
from hubodo.gap.state.terms import ModelTerm

NAME = "outliers"
_SIGMAS = np.geomspace(2.5, 100.0, 40)
_SHARES = np.geomspace(1e-5, 0.3, 40)
# Gain of ln likelihood that makes spikes of one channel worth a word.
_SPIKY = 15.0
# Noise is not quite Gaussian, whatever else is missing.
_RELUCTANCE = 2.0
_FAR, _UNLIKELY = 5.0, 1e-5


@dataclass(frozen=True)
class _Channel:
    """row: of a channel in use. z: (n,) its fresh readings beside their neighbours, in their own sigma.

    sigma: that, in units of the noise that the channel shows.
    """

    row: int
    z: Array
    sigma: float


@dataclass(frozen=True)
class _Seen:
    """What one node shows. tables: of each channel. count: of readings. chance: wild ones come anywhere."""

    tables: Sequence[Array]
    count: int
    chance: bool


def look_for_outliers(residuals: Sequence[Residual]) -> list[Proposal]:
    """A mixture of the noise and of wider noise, against it alone: probability and sigma by likelihood."""
    seen = {one.node.name: _seen(one) for one in residuals if BY_NAME[NAME] not in one.effects}
    made = []
    for scope, members in shared([one for one in residuals if one.node.name in seen]):
        own = [seen[one.node.name] for one in members]
        table = np.sum([part for one in own for part in one.tables], axis=0)
        count = sum(one.count for one in own)
        at = np.unravel_index(int(np.argmax(table)), table.shape)
        gain = float(table[at])
        if gain < 3.0 or not all(one.chance for one in own):
            continue
        share, sigma = float(_SHARES[at[0]]), float(_SIGMAS[at[1]])
        hits = max(share * count, 1.0)
        term = ModelTerm(BY_NAME[NAME](probability=share, sigma=sigma), scope)  # type: ignore[call-arg]
        sigmas = {"probability": share / np.sqrt(hits), "sigma": sigma / np.sqrt(2.0 * hits)}
        where = f"about {hits:.0f} lonely readings, {sigma:.0f} times wider than the noise"
        # Each share and each sigma of the grid is as likely beforehand.
        evidence = float(logsumexp(table)) - log(table.size) - _RELUCTANCE
        made.append(Proposal(term, gain, evidence, sigmas, where))
    return made


def spiky_channels(residual: Residual) -> list[tuple[int, int, float]]:
    """Channels with wild readings of their own: row, how many, and how large in the middle of them."""
    channels = _channels(residual)
    if _everywhere(channels) and _lonely(channels):
        return []
    made = []
    for one in channels:
        if np.max(_table(residual, one)) > _SPIKY:
            z = np.abs(one.z)
            far = z[z > 6.0]
            if len(far):
                made.append((one.row, len(far), float(np.median(far))))
    return made


def _seen(residual: Residual) -> _Seen:
    channels = _channels(residual)
    tables = [_table(residual, one) for one in channels]
    return _Seen(tables, sum(len(one.z) for one in channels), _everywhere(channels) and _lonely(channels))


def _channels(residual: Residual) -> list[_Channel]:
    """Each channel in use. A burst of misfit is no outlier: only what stands out from its own neighbours."""
    made = []
    for row in np.flatnonzero(residual.node.used).tolist():
        ok = residual.noise.fresh & ~residual.node.clipped[row]
        z = (unrounded(residual, row) / residual.noise.of(row))[ok]
        z = z - _neighbourhood(z)
        sigma = max(float(np.median(np.abs(z))) / 0.6745, 1e-9)
        made.append(_Channel(row, z / sigma, sigma))
    return made


def _everywhere(channels: Sequence[_Channel]) -> bool:
    """Whether all channels of a node are hit alike (G-test of the numbers of readings far out)."""
    counts = np.array([int((np.abs(one.z) > _FAR).sum()) for one in channels])
    total = int(counts.sum())
    if total < 8 or len(counts) < 2:
        return True
    hit = counts[counts > 0]
    statistic = 2.0 * float(np.sum(hit * np.log(hit * len(counts) / total)))
    return bool(chdtrc(len(counts) - 1, max(statistic, 0.0)) > _UNLIKELY)


def _lonely(channels: Sequence[_Channel]) -> bool:
    """Whether wild readings come one by one: no more of them side by side than chance puts there."""
    near, hits, total = 0, 0, 0
    for one in channels:
        far = np.abs(one.z) > 4.5
        hits, total = hits + int(far.sum()), total + len(far)
        near += int((far[2:] & far[:-2]).sum()) + int((far[3:] & far[:-3]).sum())
    expected = 2.0 * hits * hits / max(total, 1)
    return bool(near < 3.0 * expected + 4.0 * np.sqrt(expected) + 4.0)


def _table(residual: Residual, one: _Channel) -> Array:
    """(40, 40) gain of ln likelihood of a channel by share and sigma."""
    edges = np.concatenate([np.linspace(0.0, 6.0, 121), np.geomspace(6.2, 400.0, 100)])
    filled, _ = np.histogram(np.minimum(np.abs(one.z), 399.0), edges)
    middle = 0.5 * (edges[1:] + edges[:-1])
    filled, middle = filled[filled > 0], middle[filled > 0]
    # The noise alone, as it is: its own scale is free.
    own = np.linspace(0.9, 1.3, 21)[:, None]
    alone = float(np.max(np.sum(filled * (-0.5 * (middle / own) ** 2 - np.log(own)), axis=1)))
    # Beside neighbours with noise of their own, and beside noise that is not as declared.
    declared = float(np.mean(residual.declared_of(one.row) / residual.noise.of(one.row)))
    size = _SIGMAS * declared / one.sigma
    total = np.zeros((len(_SHARES), len(_SIGMAS)))
    wide = 1.0 / np.sqrt(1.0 + size**2)
    narrow = np.exp(-0.5 * middle**2)
    for j, share in enumerate(wide):
        far = share * np.exp(-0.5 * (middle * share) ** 2)
        mixed = (1.0 - _SHARES[:, None]) * narrow + _SHARES[:, None] * far
        total[:, j] = np.log(np.maximum(mixed, 1e-300)) @ filled - alone
    return total


def _neighbourhood(z: Array) -> Array:
    """The median of the two samples before and the two after each."""
    padded = np.pad(z, 2, mode="reflect")
    around = np.stack([padded[:-4], padded[1:-3], padded[3:-1], padded[4:]])
    around.sort(axis=0)
    return np.asarray(0.5 * (around[1] + around[2]))
