"""Samples sent again: all channels of a node equal to the sample before."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hubodo.effects import BY_NAME
from hubodo.gap.process_noise.residual import Residual
from hubodo.gap.scatter.base import Proposal, shared, single_cost
from hubodo.gap.state.terms import ModelTerm

NAME = "sample_repeat"
_LATTICE = 1e-8


def look_for_repeats(residuals: Sequence[Residual]) -> list[Proposal]:
    """How many repeats there are, against how many rounding would make by chance (Poisson)."""
    made = []
    for scope, members in shared([one for one in residuals if BY_NAME[NAME] not in one.effects]):
        seen = sum(int((~one.noise.fresh).sum()) for one in members)
        total = sum(len(one.node.t) for one in members)
        chance = max(sum(_by_chance(one) for one in members), 1e-3)
        if seen <= chance or any(not (~one.noise.fresh).any() for one in members):
            continue
        gain = seen * np.log(seen / chance) - (seen - chance) + sum(_stale(one) for one in members)
        share = seen / total
        term = ModelTerm(BY_NAME[NAME](probability=share), scope)  # type: ignore[call-arg]
        where = f"{seen} of {total} samples equal their predecessor in every channel"
        sigma = float(np.sqrt(share * (1.0 - share) / total))
        made.append(
            Proposal(term, float(gain), float(gain) - single_cost(total), {"probability": sigma}, where)
        )
    return [proposal for proposal in made if proposal.gain > 3.0]


def _by_chance(residual: Residual) -> float:
    """How many neighbours would be equal in all channels if noise were all that differs between them."""
    odds = np.ones(residual.node.y.shape[1])
    for row in np.flatnonzero(residual.node.used):
        gaps = np.diff(np.unique(np.round(residual.node.y[row], 9)))
        step = float(np.min(gaps[gaps > _LATTICE], initial=np.inf))
        if not np.isfinite(step):
            continue
        # Two draws of Gaussian noise fall into one bin of a lattice.
        odds *= np.minimum(1.0, step / (2.0 * np.sqrt(np.pi) * residual.noise.of(row)))
    return float(odds.sum())


def _stale(residual: Residual) -> float:
    """What is gained when a repeat is compared with the model of the sample that it repeats."""
    late = np.flatnonzero(~residual.noise.fresh)
    source = np.maximum.accumulate(np.where(residual.noise.fresh, np.arange(len(residual.noise.fresh)), 0))[
        late
    ]
    z = np.clip(residual.value / residual.noise.found, -6.0, 6.0)[residual.node.used]
    return 0.5 * float(np.sum(z[:, late] ** 2 - z[:, source] ** 2))
