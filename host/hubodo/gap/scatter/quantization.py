"""Quantization of gyro readings whose lattice step is not negligible compared with the noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hubodo.effects import BY_NAME
from hubodo.gap.process_noise.residual import Residual
from hubodo.gap.scatter.base import Proposal, parameter_cost
from hubodo.gap.state.terms import ALL, ModelTerm

EFFECT_NAME = "gyro_quantization"
# Relative difference up to which two steps are those of the same lattice.
_MAX_STEP_DIFFERENCE = 1e-3
_MIN_DETECTION_GAIN = 3.0
# Shares of the declared variance of the sensor, and of that of the residual on the whole log, from which on
# rounding matters; each sensor rounds a little, which shows at standstill.
_MIN_DECLARED_SHARE, _MIN_RESIDUAL_SHARE = 0.02, 0.01
# Smallest credible noise before rounding, as a share of the rounding variance.
_MIN_UNROUNDED_SHARE = 0.1


def detect_quantization(residuals: Sequence[Residual]) -> list[Proposal]:
    """Detect quantization: the step is that of the lattice, the gain that of the added variance.

    Nodes on the same lattice have the same effect, even where the noise of one of them hides it.
    """
    steps = {
        residual.node.name: find_lattice_step(residual)
        for residual in residuals
        if BY_NAME[EFFECT_NAME] not in residual.effects
    }
    members = [residual for residual in residuals if steps.get(residual.node.name)]
    values = [steps[residual.node.name] for residual in members]
    is_common = len(members) == len(residuals) > 1 and np.ptp(values) < _MAX_STEP_DIFFERENCE * values[0]
    groups = [(ALL, members)] if is_common else [(one.node.name, [one]) for one in members]
    proposals = []
    for scope, group in groups:
        step = float(np.mean([steps[residual.node.name] for residual in group]))
        gain = sum(_rounding_gain(residual, step) for residual in group)
        if gain > _MIN_DETECTION_GAIN:
            term = ModelTerm(BY_NAME[EFFECT_NAME](step=step), scope)  # type: ignore[call-arg]
            where = f"gyro readings are whole multiples of {step:.4g} rad/s, coarse beside the noise"
            evidence = gain - parameter_cost(1e4)
            proposals.append(Proposal(term, gain, evidence, {"step": 1e-5 * step}, where, is_exact=True))
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
    """Return the expected gain of ln likelihood of noise with the rounding variance, step²/12, over without.

    The lattice itself is certain, and would gain far more; the test is whether it affects the readings. The
    noise before rounding is that of each group less the rounding.
    """
    rounding = step**2 / 12.0
    if rounding < _MIN_DECLARED_SHARE * float(np.mean(residual.sensor_sigma[:3] ** 2)):
        return 0.0
    variances = []
    for row in np.flatnonzero(residual.node.used[:3]):
        is_used = residual.noise.is_new & ~residual.node.is_saturated[row]
        variances.append(residual.noise.channel_sigma(row)[is_used] ** 2)
    variance = np.concatenate(variances) if variances else np.zeros(0)
    if rounding < _MIN_RESIDUAL_SHARE * np.mean(variance):
        return 0.0
    share = rounding / np.maximum(variance - rounding, _MIN_UNROUNDED_SHARE * rounding)
    return 0.5 * float(np.sum(share - np.log1p(share)))
