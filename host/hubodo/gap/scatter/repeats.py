"""Repeated samples: all channels of a node equal to the sample before."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hubodo.arrays import Array
from hubodo.effects import BY_NAME
from hubodo.gap.process_noise.residual import Residual
from hubodo.gap.scatter.base import Proposal, group_by_scope, parameter_cost
from hubodo.gap.state.terms import ModelTerm

EFFECT_NAME = "sample_repeat"
# Sigma of a step between neighbours up to which the model is believed: its error is not Gaussian.
_MAX_STEP_SIGMA = 6.0
# Samples before and after each that show how often samples agree there, sigmas by which more do than
# elsewhere, and the probability from which on that may be chance.
_NEARBY_SAMPLES, _MIN_EXCESS_SIGMA, _MIN_STANDSTILL_CHANCE = 100, 2.0, 1e-6
# Iterations of the share of repeats (expectation maximisation), and where it starts.
_N_ITERATIONS, _INITIAL_SHARE = 30, 0.01


def detect_repeats(residuals: Sequence[Residual]) -> list[Proposal]:
    """Detect repeats by the probability that rounding makes each sample equal to its predecessor.

    A standing wheel reads the same twice by chance; while it turns no two samples agree. A sample repeats
    with probability p, or else agrees by chance with probability c_k. The likelihood ratio of N samples is
    (1 - p)ᴺ ∏ (1 + p / ((1 - p) c_k)) over the samples k that agree.
    """
    proposals = []
    chances = {
        one.node.name: _chances_of_agreement(one)
        for one in residuals
        if BY_NAME[EFFECT_NAME] not in one.effects
    }
    for scope, members in group_by_scope([one for one in residuals if one.node.name in chances]):
        agreeing = np.concatenate([chances[one.node.name] for one in members])
        total = sum(len(one.node.t) for one in members)
        share = _INITIAL_SHARE
        for _ in range(_N_ITERATIONS):
            share = float(np.sum(share / (share + (1.0 - share) * agreeing))) / total
        if not 0.0 < share < 1.0:
            continue
        gain = float(total * np.log1p(-share) + np.sum(np.log1p(share / (1.0 - share) / agreeing)))
        term = ModelTerm(BY_NAME[EFFECT_NAME](probability=share), scope)  # type: ignore[call-arg]
        where = f"{len(agreeing)} of {total} samples equal their predecessor in every channel"
        sigma = float(np.sqrt(share * (1.0 - share) / total))
        evidence = gain - parameter_cost(total)
        proposals.append(Proposal(term, gain, evidence, {"probability": sigma}, where, is_exact=True))
    return [proposal for proposal in proposals if proposal.gain > 3.0]


def _chances_of_agreement(residual: Residual) -> Array:
    """Return for each sample that equals its predecessor the largest probability of that by chance, (R,).

    Two Gaussian draws with means that differ by d fall into one bin of a lattice with probability
    step / (2 √π σ) exp(-d² / (4 σ²)), and with less if the lattice is coarse. At standstill the noise varies
    faster than it can be estimated. If samples agree much more often there than elsewhere, as repeats do not,
    they do so by chance.
    """
    is_new = residual.noise.is_new
    at = np.flatnonzero(~is_new)
    source = np.maximum.accumulate(np.where(is_new, np.arange(len(is_new)), 0))[at]
    chances = np.ones(len(at))
    for row in np.flatnonzero(residual.node.used & np.isfinite(residual.node.lattice_steps)):
        sigma = residual.noise.channel_sigma(row)[at]
        change = np.abs(residual.predicted[row, at] - residual.predicted[row, source]) / sigma
        same_bin = float(residual.node.lattice_steps[row]) / (2.0 * np.sqrt(np.pi) * sigma)
        chances *= np.minimum(same_bin * np.exp(-0.25 * np.minimum(change, _MAX_STEP_SIGMA) ** 2), 1.0)
    n_nearby = 2 * _NEARBY_SAMPLES + 1
    agreeing = np.convolve(~is_new, np.ones(n_nearby), "same")[at]
    expected = np.mean(~is_new) * n_nearby
    is_clustered = agreeing > expected + _MIN_EXCESS_SIGMA * np.sqrt(expected + 1.0)
    return np.where(
        is_clustered & (chances > _MIN_STANDSTILL_CHANCE), np.maximum(chances, agreeing / n_nearby), chances
    )
