"""Gyro readings on a lattice: whether its step is coarse enough to matter beside the noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hubodo.effects import BY_NAME
from hubodo.gap.process_noise.residual import Residual
from hubodo.gap.scatter.base import Proposal, shared, single_cost
from hubodo.gap.state.terms import ModelTerm

NAME = "gyro_quantization"
# Noise beyond what is declared may be this many times what rounding makes.
_LARGER = 10.0


def look_for_quantization(residuals: Sequence[Residual]) -> list[Proposal]:
    """The step is read off the lattice; the gain is that of the variance which rounding adds."""
    steps = {one.node.name: lattice_step(one) for one in residuals if BY_NAME[NAME] not in one.effects}
    made = []
    for scope, members in shared([one for one in residuals if steps.get(one.node.name)]):
        own = [steps[one.node.name] for one in members]
        if np.ptp(own) > 1e-3 * own[0]:
            continue
        step = float(np.mean(own))
        gain = sum(_gain(one, step) for one in members)
        if gain > 3.0:
            term = ModelTerm(BY_NAME[NAME](step=step), scope)  # type: ignore[call-arg]
            where = f"gyro readings are whole multiples of {step:.4g} rad/s, coarse beside the noise"
            made.append(Proposal(term, gain, gain - single_cost(1e4), {"step": 1e-5 * step}, where))
    return made


def lattice_step(residual: Residual) -> float:
    """The step of which all gyro readings are whole multiples, rad/s; 0 where there is none."""
    found = []
    for row in range(3):
        if not residual.node.used[row]:
            continue
        values = np.unique(np.round(residual.node.y[row], 9))
        # Where hardly two readings are equal, what lies between them is no step; other axes show it.
        if len(values) < 3 or len(values) > 0.5 * residual.node.y.shape[1]:
            continue
        gaps = np.diff(values)
        step = float(np.median(gaps[gaps <= 1.5 * gaps[gaps > 1e-8].min(initial=np.inf)]))
        # Fine-tuned on the largest readings, where an error of the step shows most.
        for _ in range(3):
            whole = np.round(values / step)
            step = float(values @ whole) / max(float(whole @ whole), 1.0)
        off = np.abs(values / step - np.round(values / step))
        if np.mean(off < 0.02) < 0.98:
            return 0.0
        found.append(step)
    if not found or np.ptp(found) > 1e-3 * found[0]:
        return 0.0
    return float(np.mean(found))


def _gain(residual: Residual, step: float) -> float:
    """ln likelihood with the variance of rounding, step²/12, less that with the declared noise alone.

    The lattice itself is beyond doubt; the question is whether it matters. Where the noise is larger than
    declared for other reasons, the lattice gets no more credit than its step is worth; none where these are
    by far the larger part.
    """
    total, worth = 0.0, 0.0
    for row in np.flatnonzero(residual.node.used[:3]):
        ok = residual.noise.fresh & ~residual.node.clipped[row]
        alone = residual.declared_of(row)[ok] ** 2
        if np.mean(residual.noise.of(row)[ok] ** 2 - alone) > _LARGER * step**2 / 12.0:
            return 0.0
        both = alone + step**2 / 12.0
        off = residual.value[row][ok] ** 2
        # Wild readings are another matter.
        calm = off < 16.0 * both
        total += 0.5 * float(np.sum((off / alone - off / both - np.log(both / alone))[calm]))
        share = step**2 / 12.0 / alone
        worth += 0.5 * float(np.sum(share - np.log1p(share)))
    return min(total, 1.5 * worth)
