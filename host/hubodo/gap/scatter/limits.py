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
# Largest relative difference of two limits that are equal.
_EQUAL_LIMITS = 1e-3
_TRIAD_ROWS = (("gyro_saturation", slice(0, 3)), ("accel_saturation", slice(3, 6)))


def detect_limits(residuals: Sequence[Residual]) -> list[Proposal]:
    """Detect saturation: readings at the limit have the probability of the whole tail beyond it."""
    proposals = []
    for triad, (name, rows) in enumerate(_TRIAD_ROWS):
        candidates = [residual for residual in residuals if BY_NAME[name] not in residual.effects]
        own = {residual.node.name: float(residual.node.saturation_limits[triad]) for residual in candidates}
        clipped = [_examine_limit(r, own[r.node.name], rows) for r in candidates if own[r.node.name] < np.inf]
        step = max((one.step for one in clipped), default=0.0)
        proposals += [_propose(name, one.node, one.limit, one.gain, step) for one in clipped]
        if not clipped or len(candidates) != len(residuals) or len(residuals) < 2:
            continue
        # Nodes of one kind have the same limit, which a single reading can show in another node.
        common = clipped[0].limit
        others = [residual for residual in candidates if own[residual.node.name] == np.inf]
        is_equal = all(abs(one.limit - common) < _EQUAL_LIMITS * common for one in clipped)
        if is_equal and all(_is_highest(residual, common, rows) for residual in others):
            clipped += [_examine_limit(residual, common, rows, one_counts=True) for residual in others]
            limit = float(np.mean([one.limit for one in clipped]))
            proposals.append(_propose(name, ALL, limit, sum(one.gain for one in clipped), step))
    return [proposal for proposal in proposals if proposal.gain > 3.0]


@dataclass(frozen=True)
class _Limit:
    """Limit of a triad of one node, the step below it, and the gain of ln likelihood by clipping there."""

    node: str
    limit: float
    step: float
    gain: float


def _examine_limit(residual: Residual, limit: float, rows: slice, *, one_counts: bool = False) -> _Limit:
    """Return the limit of a triad with the gain of its clipped readings.

    A clipped reading has the probability of the tail beyond the limit, and without clipping that of one step
    of the lattice there. One reading is the largest without any limit, too, and does not count (one_counts:
    unless the limit is that of another node).
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
    without_largest = 0.0 if one_counts else gains.max(initial=0.0)
    return _Limit(residual.node.name, limit, step, float(gains.sum() - without_largest))


def _is_highest(residual: Residual, limit: float, rows: slice) -> bool:
    """Return True if the highest reading of a triad equals a limit."""
    highest = np.abs(residual.node.y[rows]).max(initial=0.0)
    return bool(is_at_limit(highest, limit) and is_at_limit(np.array(limit), highest))


def _propose(name: str, scope: str, limit: float, gain: float, step: float) -> Proposal:
    term = ModelTerm(BY_NAME[name](limit=limit), scope)  # type: ignore[call-arg]
    where = f"readings pile up at ±{limit:.4g}, as at a limit"
    sigmas = {"limit": max(0.5 * step, 1e-6 * limit)}
    return Proposal(term, gain, gain - parameter_cost(1e4), sigmas, where, is_exact=True)
