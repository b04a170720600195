"""Saturation: the largest readings of a triad are all the same, and the model wants more."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hubodo.effects import BY_NAME
from hubodo.gap.process_noise.residual import Residual
from hubodo.gap.scatter.base import Proposal, single_cost
from hubodo.gap.state.terms import ALL, ModelTerm

_TRIADS = (("gyro_saturation", slice(0, 3)), ("accel_saturation", slice(3, 6)))


def look_for_limits(residuals: Sequence[Residual]) -> list[Proposal]:
    """The limit is read off; the gain is what clipping the model there takes off the residual."""
    made = []
    for place, (name, rows) in enumerate(_TRIADS):
        effect = BY_NAME[name]
        found: dict[str, tuple[float, float]] = {}
        step = 0.0
        for residual in residuals:
            limit = residual.node.limits[place]
            if not np.isfinite(limit) or effect in residual.effects:
                continue
            # The limit lies somewhere in the last step of the lattice.
            below = np.unique(np.abs(residual.node.y[rows]))
            step = max(step, float(below[-1] - below[-2]) if len(below) > 1 else 0.0)
            model = residual.node.y[rows] - residual.value[rows]
            weight = residual.noise.fresh / residual.noise.found[rows]
            before = np.clip(residual.value[rows] * weight, -20.0, 20.0)
            after = np.clip((residual.node.y[rows] - np.clip(model, -limit, limit)) * weight, -20.0, 20.0)
            found[residual.node.name] = (limit, 0.5 * float((before**2 - after**2).sum()))
        for node, (limit, gain) in found.items():
            made.append(_proposal(name, node, limit, gain, step))
        values = [limit for limit, _ in found.values()]
        if len(found) > 1 and len(found) == len(residuals) and np.ptp(values) < 1e-3 * values[0]:
            gain = sum(gain for _, gain in found.values())
            made.append(_proposal(name, ALL, float(np.mean(values)), gain, step))
    return [proposal for proposal in made if proposal.gain > 3.0]


def _proposal(name: str, scope: str, limit: float, gain: float, step: float) -> Proposal:
    term = ModelTerm(BY_NAME[name](limit=limit), scope)  # type: ignore[call-arg]
    where = f"readings stop at ±{limit:.4g} where the model goes beyond"
    return Proposal(term, gain, gain - single_cost(1e4), {"limit": max(0.5 * step, 1e-6 * limit)}, where)
