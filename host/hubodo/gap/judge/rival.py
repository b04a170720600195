"""One candidate of a round as it is judged: its gain after a refit, and its evidence against its absence."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hubodo.arrays import Array
from hubodo.gap.refit.refit import Refit, gain_over
from hubodo.gap.scatter import Proposal
from hubodo.gap.screen.evidence import USUAL, log_evidence
from hubodo.gap.screen.null_distribution import NullDistribution
from hubodo.gap.screen.screening import Screened
from hubodo.gap.screen.unlisted import Structure
from hubodo.gap.state.state import State
from hubodo.gap.state.terms import ModelTerm

# A refit that gains this many times what the linear model promised, and so much of ln likelihood beside, has
# found something else: no effect bends that much within a step. Chosen; `make gap-matrix` judges it.
_PROMISED, _BESIDE = 20.0, 20.0


@dataclass(frozen=True)
class Rival:
    """One candidate of a round.

    gain: in ln likelihood. evidence: ln Bayes factor against its absence. probability: among all of its
    round, and nothing. state: where its refit ended; proposal: of a look at scatter.
    """

    term: ModelTerm
    gain: float
    evidence: float
    probability: float
    state: State | None = None
    proposal: Proposal | None = None

    @property
    def label(self) -> tuple[str, str]:
        return self.term.key

    def bare(self) -> Rival:
        """For keeping, where no search goes on from it: the paths of the wheels take much memory."""
        state = None if self.state is None else replace(self.state, starts={}, paths={}, late={})
        return replace(self, state=state)

    def p_value(self, null: NullDistribution) -> float:
        """How often the best of all would gain as much by chance."""
        return null.p_value(self.gain, len(self.term.effect.coordinates()))


def named_rival(before: Refit, screened: Screened, made: Refit, tempering: float) -> Rival:
    """An effect that was screened and refitted."""
    term = next(term for term in made.free if term.key == screened.candidate.term.key)
    gain = _believed(gain_over(before, made), screened.gain)
    evidence = _evidence(screened, made.information(term), gain, tempering) - term.effect.neg_log_prior()
    return Rival(term, gain, evidence, 0.0, made.point.bare().state)


def scattered_rival(before: Refit, proposal: Proposal, walker: Refit | None, tempering: float) -> Rival:
    """An effect that shows in scatter; a walk is judged as the others are, the paths of the wheels free."""
    gain = proposal.gain if walker is None else gain_over(before, walker)
    evidence = gain / tempering - (proposal.gain - proposal.evidence)
    return Rival(proposal.term, gain, evidence, 0.0, None, proposal)


def unnamed_rival(before: Refit, structure: Structure, made: Refit, tempering: float) -> Rival:
    """A term without a name, refitted."""
    term = next(term for term in made.free if term.key == structure.term.key)
    gain = _believed(gain_over(before, made), structure.gain)
    evidence = gain / tempering - (structure.gain - structure.evidence)
    return Rival(term, gain, evidence, 0.0, made.point.bare().state)


def _believed(gain: float, promised: float) -> float:
    return min(gain, _PROMISED * promised + _BESIDE)


def _evidence(screened: Screened, information: Array, gain: float, tempering: float) -> float:
    """ln Bayes factor after the refit.

    The linear model where the candidate begins says which of its coordinates are at work; what it could not
    see there (the time constant of nothing) is paid for where the refit ended.
    """
    linear = log_evidence(screened.gain / tempering, screened.value, screened.information / tempering)
    unseen = (np.diag(screened.information) <= 0.0) & (np.diag(information) > 0.0)
    extra = 0.5 * float(np.sum(np.log1p(USUAL**2 * np.diag(information)[unseen] / tempering)))
    return linear + (gain - screened.gain) / tempering - extra
