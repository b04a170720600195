"""Saturation: the largest readings of a triad are equal, and the model predicts larger ones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hubodo.effects import BY_NAME
from hubodo.gap.process_noise.residual import Residual
from hubodo.gap.scatter.base import Proposal, parameter_cost
from hubodo.gap.state.terms import ALL, ModelTerm

_TRIAD_ROWS = (("gyro_saturation", slice(0, 3)), ("accel_saturation", slice(3, 6)))


def detect_limits(residuals: Sequence[Residual]) -> list[Proposal]:
    """Detect saturation; the gain is the residual removed by clipping the prediction."""
    proposals = []
    for triad, (name, rows) in enumerate(_TRIAD_ROWS):
        effect = BY_NAME[name]
        limits_and_gains: dict[str, tuple[float, float]] = {}
        step = 0.0
        for residual in residuals:
            limit = residual.node.saturation_limits[triad]
            if not np.isfinite(limit) or effect in residual.effects:
                continue
            # The limit lies within the last step of the lattice.
            below = np.unique(np.abs(residual.node.y[rows]))
            step = max(step, float(below[-1] - below[-2]) if len(below) > 1 else 0.0)
            model = residual.node.y[rows] - residual.value[rows]
            weight = residual.noise.is_new / residual.noise.sigma[rows]
            before = np.clip(residual.value[rows] * weight, -20.0, 20.0)
            after = np.clip((residual.node.y[rows] - np.clip(model, -limit, limit)) * weight, -20.0, 20.0)
            limits_and_gains[residual.node.name] = (limit, 0.5 * float((before**2 - after**2).sum()))
        for node, (limit, gain) in limits_and_gains.items():
            proposals.append(_propose(name, node, limit, gain, step))
        values = [limit for limit, _ in limits_and_gains.values()]
        if (
            len(limits_and_gains) > 1
            and len(limits_and_gains) == len(residuals)
            and np.ptp(values) < 1e-3 * values[0]
        ):
            gain = sum(gain for _, gain in limits_and_gains.values())
            proposals.append(_propose(name, ALL, float(np.mean(values)), gain, step))
    return [proposal for proposal in proposals if proposal.gain > 3.0]


def _propose(name: str, scope: str, limit: float, gain: float, step: float) -> Proposal:
    term = ModelTerm(BY_NAME[name](limit=limit), scope)  # type: ignore[call-arg]
    where = f"readings stop at ±{limit:.4g} where the model goes beyond"
    return Proposal(term, gain, gain - parameter_cost(1e4), {"limit": max(0.5 * step, 1e-6 * limit)}, where)
