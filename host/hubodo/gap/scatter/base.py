"""What a look at one kind of scatter returns, and the scopes in which it looks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import log

import numpy as np
from scipy.special import ndtr, ndtri

from hubodo.arrays import Array
from hubodo.gap.process_noise.residual import Residual
from hubodo.gap.state.terms import ALL, ModelTerm


@dataclass(frozen=True)
class Proposal:
    """An effect that would explain the scatter. gain: of the log-likelihood. evidence: ln Bayes factor.

    sigmas: 1 sigma of its parameters. where: what shows it, in words.
    """

    term: ModelTerm
    gain: float
    evidence: float
    sigmas: Mapping[str, float]
    where: str


Look = Callable[[Sequence[Residual]], list[Proposal]]
"""From what each node shows beside the mean to what may be missing there."""


def single_cost(samples: float) -> float:
    """Occam's factor of one parameter that so many samples fix: ½ ln(samples), as in BIC."""
    return 0.5 * log(max(samples, 3.0))


def shared(residuals: Sequence[Residual]) -> list[tuple[str, list[Residual]]]:
    """The scopes: each node, and all of them where there are several."""
    single = [(one.node.name, [one]) for one in residuals]
    return [*single, (ALL, list(residuals))] if len(residuals) > 1 else single


# Sigmas beyond which what rounding does to a reading no longer matters.
_FAR = 6.0


def unrounded(residual: Residual, row: int) -> Array:
    """(N,) residual of a channel, where its lattice is coarser than the noise as it was before the rounding.

    A coarse lattice makes Gaussian noise none: some readings are a step off, all others are not. What was
    rounded is drawn from all that would have been rounded so (randomised quantile residuals, Dunn and Smyth
    1996), in the noise that the channel shows.
    """
    value, sigma, step = residual.value[row], residual.declared_of(row), float(residual.node.steps[row])
    if not np.isfinite(step) or step < np.median(sigma):
        return np.asarray(value)
    z = np.abs(value) / sigma
    low, high = ndtr(-z - 0.5 * step / sigma), ndtr(-z + 0.5 * step / sigma)
    drawn = low + (high - low) * np.random.default_rng(row).random(len(z))
    made = np.where(z - 0.5 * step / sigma < _FAR, -ndtri(np.maximum(drawn, 1e-300)), z)
    return np.asarray(np.sign(value) * made * residual.noise.of(row))
