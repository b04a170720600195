"""Saturation: the largest readings of a triad are equal, and the model predicts larger ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr

from hubodo.effects import BY_NAME
from hubodo.gap.problem.saturation import is_at_limit
from hubodo.gap.process_noise.residual import Residual
from hubodo.gap.scatter.base import Proposal, parameter_cost
from hubodo.gap.state.terms import ALL, ModelTerm

# Sigmas beyond which a prediction is no more believed: its error is not Gaussian.
_MAX_PREDICTION_SIGMA = 20.0
_TRIAD_ROWS = (("gyro_saturation", slice(0, 3)), ("accel_saturation", slice(3, 6)))


def detect_limits(residuals: Sequence[Residual]) -> list[Proposal]:
    """Detect saturation: readings at the limit have the probability of the whole tail beyond it."""
    proposals = []
    for triad, (name, rows) in enumerate(_TRIAD_ROWS):
        clipped = [
            _examine_limit(residual, float(residual.node.saturation_limits[triad]), rows)
            for residual in residuals
            if np.isfinite(residual.node.saturation_limits[triad]) and BY_NAME[name] not in residual.effects
        ]
        step = max((one.step for one in clipped), default=0.0)
        proposals += [_propose(name, one.node, one.limit, one.gain, step) for one in clipped]
        limits = [one.limit for one in clipped]
        if len(clipped) == len(residuals) > 1 and np.ptp(limits) < 1e-3 * limits[0]:
            gain = sum(one.gain for one in clipped)
            proposals.append(_propose(name, ALL, float(np.mean(limits)), gain, step))
    return [proposal for proposal in proposals if proposal.gain > 3.0]


@dataclass(frozen=True)
class _Limit:
    """Limit of a triad of one node, the step below it, and the gain of ln likelihood by clipping there."""

    node: str
    limit: float
    step: float
    gain: float


def _examine_limit(residual: Residual, limit: float, rows: slice) -> _Limit:
    """Return the limit of a triad with the gain of its clipped readings.

    A clipped reading has the probability of the tail beyond the limit, and without clipping that of one step
    of the lattice there. One reading is the largest without any limit, too, and does not count.
    """
    at_limit = is_at_limit(residual.node.y[rows], limit) & residual.noise.is_new
    sigma, steps = residual.noise.sigma[rows], residual.node.lattice_steps[rows]
    lattice = np.minimum(np.where(np.isfinite(steps), steps, 0.0)[:, None], sigma)
    z = (limit - np.sign(residual.node.y[rows]) * residual.predicted[rows]) / sigma
    z = np.clip(z, -_MAX_PREDICTION_SIGMA, _MAX_PREDICTION_SIGMA)
    gains = (
        log_ndtr(-z) + 0.5 * z**2 + np.log(np.sqrt(2.0 * np.pi) * sigma / np.maximum(lattice, 1e-3 * sigma))
    )
    gains = gains[at_limit]
    below = np.unique(np.abs(residual.node.y[rows]))
    # The limit lies within the last step of the lattice.
    step = float(below[-1] - below[-2]) if len(below) > 1 else 0.0
    return _Limit(residual.node.name, limit, step, float(gains.sum() - gains.max(initial=0.0)))


def _propose(name: str, scope: str, limit: float, gain: float, step: float) -> Proposal:
    term = ModelTerm(BY_NAME[name](limit=limit), scope)  # type: ignore[call-arg]
    where = f"readings pile up at ±{limit:.4g}, as at a limit"
    sigmas = {"limit": max(0.5 * step, 1e-6 * limit)}
    return Proposal(term, gain, gain - parameter_cost(1e4), sigmas, where, is_exact=True)
