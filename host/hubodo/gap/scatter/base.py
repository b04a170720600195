"""Proposals of the scatter detectors, and helpers that the detectors share."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import inf, log

import numpy as np
from scipy.special import ndtr, ndtri

from hubodo.arrays import Array
from hubodo.gap.process_noise.residual import Residual
from hubodo.gap.state.terms import ALL, ModelTerm


@dataclass(frozen=True)
class Proposal:
    """An effect that would explain the scatter.

    gain: gain of the log-likelihood
    evidence: ln Bayes factor
    sigmas: 1 sigma of the parameters of the effect
    where: the observation as text
    is_exact: True if equal readings show the effect, which correlation of the residuals does not imitate
    smooth_advantage: gain of a smooth drift over that of a random walk, if the effect is one
    """

    term: ModelTerm
    gain: float
    evidence: float
    sigmas: Mapping[str, float]
    where: str
    is_exact: bool = False
    smooth_advantage: float = -inf


ScatterDetector = Callable[[Sequence[Residual]], list[Proposal]]
"""A function from residuals about the mean of each node to proposed effects."""


def parameter_cost(samples: float) -> float:
    """Return the Occam factor of one parameter determined by `samples` samples: ½ ln(samples), as in BIC."""
    return 0.5 * log(max(samples, 3.0))


def group_by_scope(residuals: Sequence[Residual]) -> list[tuple[str, list[Residual]]]:
    """Return the residuals by scope: each node alone, and all nodes together if there are several."""
    groups = [(one.node.name, [one]) for one in residuals]
    return [*groups, (ALL, list(residuals))] if len(residuals) > 1 else groups


# Sigmas beyond which rounding no longer changes the tail probability.
_MAX_ROUNDING_SIGMA = 6.0


def remove_rounding(residual: Residual, row: int) -> Array:
    """Return the residual of a channel, (N,), with coarse rounding undone.

    Gaussian noise on a coarse lattice is not Gaussian: most readings agree, some are one step off. Each
    rounded residual is replaced by a draw from its rounding interval (randomised quantile residuals, Dunn and
    Smyth 1996), scaled to the estimated noise.
    """
    value, sigma, step = (
        residual.value[row],
        residual.declared_channel_sigma(row),
        float(residual.node.lattice_steps[row]),
    )
    if not np.isfinite(step) or step < np.median(sigma):
        return np.asarray(value)
    z = np.abs(value) / sigma
    low, high = ndtr(-z - 0.5 * step / sigma), ndtr(-z + 0.5 * step / sigma)
    drawn = low + (high - low) * np.random.default_rng(row).random(len(z))
    unrounded = np.where(z - 0.5 * step / sigma < _MAX_ROUNDING_SIGMA, -ndtri(np.maximum(drawn, 1e-300)), z)
    return np.asarray(np.sign(value) * unrounded * residual.noise.channel_sigma(row))
