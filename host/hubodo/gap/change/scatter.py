"""Changes of effects that are visible only in scatter, resolution and saturation."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from hubodo.gap.change.difference import ChangeCandidate, LogPair
from hubodo.gap.judge.hypothesis import Baseline, judge_proposal
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.refit.linear_fit import linearise_fit
from hubodo.gap.scatter import SCATTER_DETECTORS, Proposal
from hubodo.gap.state.terms import ModelTerm

# Largest change of a parameter between two logs that is ignored: relative, and in sigma.
_MAX_RELATIVE_DIFFERENCE, _MAX_DIFFERENCE_SIGMA = 0.2, 5.0


def list_scatter_differences(pair: LogPair) -> Iterator[ChangeCandidate]:
    """Yield the effects on scatter that the second log shows and the first does not, or with other values."""
    before, after = (_detect(evaluation) for evaluation in pair.evaluations)
    given = {term.key: term for term in pair.evaluations[1].state.terms}
    for key, proposal in after.items():
        if key in given and _is_similar(given[key], proposal):
            continue
        if key in before and _is_similar(before[key].term, proposal):
            continue
        fits = pair.fits
        state = fits[1].state.with_term(proposal.term)
        with_term = linearise_fit(fits[1].evaluation.with_state(state))
        walk_fit = with_term if proposal.term.effect.is_process() else None
        hypothesis = judge_proposal(Baseline(fits[1], 0.0, pair.tempering), proposal, walk_fit)
        yield ChangeCandidate(hypothesis, replace(pair, fits=(fits[0], with_term.without_cache())))


def _detect(evaluation: Evaluation) -> dict[tuple[str, str], Proposal]:
    """Return the proposals of all detectors, for a model without effects on scatter."""
    remaining = [
        term
        for term in evaluation.state.terms
        if term.effect.visible_in == "mean" or term.effect.is_process()
    ]
    bare = evaluation.with_state(evaluation.state.with_terms(remaining))
    residuals = list(bare.mean_residuals.values())
    proposals: Sequence[Proposal] = [one for detect in SCATTER_DETECTORS for one in detect(residuals)]
    return {one.term.key: one for one in proposals}


def _is_similar(term: ModelTerm, proposal: Proposal) -> bool:
    """Return True if a term has the parameters of a proposal."""
    values = term.effect.values()
    return all(
        abs(value - values[name])
        < max(_MAX_RELATIVE_DIFFERENCE * abs(value), _MAX_DIFFERENCE_SIGMA * proposal.sigmas.get(name, 0.0))
        for name, value in proposal.term.effect.values().items()
        if name in proposal.term.effect.fitted_parameters()
    )
