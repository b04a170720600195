"""Quantization of gyro readings whose lattice step is not negligible compared with the noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hubodo.effects import BY_NAME
from hubodo.gap.process_noise.residual import Residual
from hubodo.gap.scatter.base import Proposal, group_by_scope, parameter_cost
from hubodo.gap.state.terms import ModelTerm

EFFECT_NAME = "gyro_quantization"
# Largest ratio of undeclared noise variance to rounding variance.
_MAX_EXCESS_RATIO = 10.0


def detect_quantization(residuals: Sequence[Residual]) -> list[Proposal]:
    """Detect quantization: the step is that of the lattice, the gain that of the added variance."""
    steps = {
        residual.node.name: find_lattice_step(residual)
        for residual in residuals
        if BY_NAME[EFFECT_NAME] not in residual.effects
    }
    proposals = []
    for scope, members in group_by_scope(
        [residual for residual in residuals if steps.get(residual.node.name)]
    ):
        member_steps = [steps[residual.node.name] for residual in members]
        if np.ptp(member_steps) > 1e-3 * member_steps[0]:
            continue
        step = float(np.mean(member_steps))
        gain = sum(_rounding_gain(residual, step) for residual in members)
        if gain > 3.0:
            term = ModelTerm(BY_NAME[EFFECT_NAME](step=step), scope)  # type: ignore[call-arg]
            where = f"gyro readings are whole multiples of {step:.4g} rad/s, coarse beside the noise"
            proposals.append(Proposal(term, gain, gain - parameter_cost(1e4), {"step": 1e-5 * step}, where))
    return proposals


def find_lattice_step(residual: Residual) -> float:
    """Return the step, rad/s, of which all gyro readings are integer multiples; 0 if there is none."""
    steps = []
    for row in range(3):
        if not residual.node.used[row]:
            continue
        values = np.unique(np.round(residual.node.y[row], 9))
        # If hardly any readings repeat, their spacing is not the step; other axes show it.
        if len(values) < 3 or len(values) > 0.5 * residual.node.y.shape[1]:
            continue
        gaps = np.diff(values)
        step = float(np.median(gaps[gaps <= 1.5 * gaps[gaps > 1e-8].min(initial=np.inf)]))
        # Refine by least squares; large readings dominate, where an error of the step is largest.
        for _ in range(3):
            multiples = np.round(values / step)
            step = float(values @ multiples) / max(float(multiples @ multiples), 1.0)
        remainder = np.abs(values / step - np.round(values / step))
        if np.mean(remainder < 0.02) < 0.98:
            return 0.0
        steps.append(step)
    if not steps or np.ptp(steps) > 1e-3 * steps[0]:
        return 0.0
    return float(np.mean(steps))


def _rounding_gain(residual: Residual, step: float) -> float:
    """Return ln likelihood with the rounding variance, step²/12, minus that with the declared noise alone.

    The existence of the lattice is certain; the test is whether it affects the readings. If the noise exceeds
    its declaration for other reasons, the gain is limited to what the step can explain, and is 0 where other
    reasons dominate.
    """
    total, expected = 0.0, 0.0
    for row in np.flatnonzero(residual.node.used[:3]):
        is_used = residual.noise.is_new & ~residual.node.is_saturated[row]
        declared = residual.declared_channel_sigma(row)[is_used] ** 2
        if (
            np.mean(residual.noise.channel_sigma(row)[is_used] ** 2 - declared)
            > _MAX_EXCESS_RATIO * step**2 / 12.0
        ):
            return 0.0
        rounded = declared + step**2 / 12.0
        squared = residual.value[row][is_used] ** 2
        # Outliers are left out, as they are a different effect.
        is_regular = squared < 16.0 * rounded
        total += 0.5 * float(
            np.sum((squared / declared - squared / rounded - np.log(rounded / declared))[is_regular])
        )
        share = step**2 / 12.0 / declared
        expected += 0.5 * float(np.sum(share - np.log1p(share)))
    return min(total, 1.5 * expected)
