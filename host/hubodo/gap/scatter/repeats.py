"""Repeated samples: all channels of a node equal to the sample before."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hubodo.effects import BY_NAME
from hubodo.gap.problem.problem import MIN_LATTICE_STEP
from hubodo.gap.process_noise.residual import Residual
from hubodo.gap.scatter.base import Proposal, group_by_scope, parameter_cost
from hubodo.gap.state.terms import ModelTerm

EFFECT_NAME = "sample_repeat"


def detect_repeats(residuals: Sequence[Residual]) -> list[Proposal]:
    """Detect repeats by comparing their number with that expected from rounding (Poisson)."""
    proposals = []
    for scope, members in group_by_scope(
        [residual for residual in residuals if BY_NAME[EFFECT_NAME] not in residual.effects]
    ):
        repeats = sum(int((~residual.noise.is_new).sum()) for residual in members)
        total = sum(len(residual.node.t) for residual in members)
        expected = max(sum(_expected_repeats(residual) for residual in members), 1e-3)
        if repeats <= expected or any(not (~residual.noise.is_new).any() for residual in members):
            continue
        gain = (
            repeats * np.log(repeats / expected)
            - (repeats - expected)
            + sum(_stale_gain(residual) for residual in members)
        )
        share = repeats / total
        term = ModelTerm(BY_NAME[EFFECT_NAME](probability=share), scope)  # type: ignore[call-arg]
        where = f"{repeats} of {total} samples equal their predecessor in every channel"
        sigma = float(np.sqrt(share * (1.0 - share) / total))
        proposals.append(
            Proposal(term, float(gain), float(gain) - parameter_cost(total), {"probability": sigma}, where)
        )
    return [proposal for proposal in proposals if proposal.gain > 3.0]


def _expected_repeats(residual: Residual) -> float:
    """Return the expected number of equal neighbours if they differ by noise alone."""
    probability = np.ones(residual.node.y.shape[1])
    for row in np.flatnonzero(residual.node.used):
        gaps = np.diff(np.unique(np.round(residual.node.y[row], 9)))
        step = float(np.min(gaps[gaps > MIN_LATTICE_STEP], initial=np.inf))
        if not np.isfinite(step):
            continue
        # Probability that two draws of Gaussian noise fall into one bin of the lattice.
        probability *= np.minimum(1.0, step / (2.0 * np.sqrt(np.pi) * residual.noise.channel_sigma(row)))
    return float(probability.sum())


def _stale_gain(residual: Residual) -> float:
    """Return the gain of comparing each repeat with the prediction for the sample that it repeats."""
    repeats = np.flatnonzero(~residual.noise.is_new)
    source = np.maximum.accumulate(np.where(residual.noise.is_new, np.arange(len(residual.noise.is_new)), 0))[
        repeats
    ]
    z = np.clip(residual.value / residual.noise.sigma, -6.0, 6.0)[residual.node.used]
    return 0.5 * float(np.sum(z[:, repeats] ** 2 - z[:, source] ** 2))
