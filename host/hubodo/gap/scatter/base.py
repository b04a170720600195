"""What a look at one kind of scatter returns, and the scopes in which it looks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import log

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
