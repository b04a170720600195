"""Changes where residuals are correlated: the second log is judged with the model of the first.

Effects of that model may differ by as much as one drive differs from the next. Effects that it lacks have to
pay on samples to which they were not fitted, as in `workflow.py`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from itertools import product

from hubodo.effects import BY_NAME
from hubodo.effects.empirical import PREFIX
from hubodo.effects.mounting import LeverArm, NodeMisalignment
from hubodo.gap.change.result import Change, ChangeResult, subtract_estimates
from hubodo.gap.explain.finding import estimate_parameters
from hubodo.gap.explain.result import Estimate, Finding
from hubodo.gap.judge.round import ReportProgress
from hubodo.gap.judge.search import SearchResult, build_initial_state
from hubodo.gap.problem.problem import Problem
from hubodo.gap.refit.linear_fit import Refit
from hubodo.gap.refit.refit import refit, refit_with_weights
from hubodo.gap.state.terms import ALL, ModelTerm, model_of_terms
from hubodo.gap.workflow import find_problem_gap
from hubodo.model.model_file import Model

# Fraction of the reported progress for the search of the first log.
FIRST_LOG_SHARE = 0.55
# Iterations of the fit of an effect of the second log to the first.
_FIRST_LOG_ROUNDS = 4
# Change in usual sizes, and in sigma from the scatter of blocks, by which fits to two drives differ anyway.
# Two halves of drives of an unchanged car reached 0.47, and 5.8 in another parameter.
_MIN_CHANGE_SCALES, _MIN_CHANGE_SIGMA = 0.5, 6.0
# Distance across the axle from which on a sensor is mounted elsewhere, m: five usual sizes of a lever arm.
_MIN_REMOUNTED_DISTANCE = 0.05


def model_of_fit(first_fit: Refit) -> Model:
    """Return the model file with the effects of the first log, without unnamed terms."""
    terms = [term for term in first_fit.state.terms if not term.effect.name.startswith(PREFIX)]
    return model_of_terms(first_fit.state.problem.model, terms)


def is_remounted(problem: Problem) -> bool:
    """Return True if a sensor is mounted elsewhere on its wheel than the model of the problem says.

    Lever arm and misalignment of each node then change at once, and no single effect explains the log.
    """
    state = build_initial_state(problem)
    names = [node.name for node in problem.nodes if node.on_wheel]
    given = {name: state.effects[name] for name in names}
    for name, kind in product(names, (NodeMisalignment, LeverArm)):
        state = state.with_term(ModelTerm(given[name].get(kind, kind()), name))
    fitted = refit_with_weights(state).state.effects
    arms = [(given[name].get(LeverArm, LeverArm()), fitted[name][LeverArm]) for name in names]
    distances = [
        math.hypot(*(after.values()[axis] - before.values()[axis] for axis in ("x", "y")))
        for before, after in arms
    ]
    return max(distances, default=0.0) > _MIN_REMOUNTED_DISTANCE


def judge_second_log(
    first_fit: Refit, second_problem: Problem, log_name: str, report_progress: ReportProgress
) -> ChangeResult:
    """Return what the model of the first log lacks to explain the second log.

    first_fit: fit of the effects of the first log
    second_problem: the second log with the model of the first
    """
    missing = find_problem_gap(
        second_problem,
        # The model was fitted with wheels like these; without them a round of the search would repeat.
        has_steady_wheels=first_fit.state.has_steady_wheels,
        report_progress=lambda words, share: report_progress(
            f"{log_name}, {words}", FIRST_LOG_SHARE + (1.0 - FIRST_LOG_SHARE) * share
        ),
    )
    named = [finding for finding in missing.found if not finding.effect.startswith(PREFIX)]
    terms = {term.key: term for term in missing.search.final.state.terms}
    changes = [
        _build_change(one, first_fit)
        for one in named
        if one.belongs_to_drive or _is_significant(one, terms[one.effect, one.scope], first_fit)
    ]
    return ChangeResult(
        _compute_p_value(missing.search),
        tuple(sorted(changes, key=lambda change: change.belongs_to_drive)),
        tuple(finding.effect for finding in missing.found if finding not in named),
        second_problem.model,
        missing.model,
        tuple(dict.fromkeys((*first_fit.state.problem.warnings, *missing.warnings))),
        is_correlated=True,
    )


def _compute_p_value(search: SearchResult) -> float:
    """Return the probability that the best candidate of the first round gains as much by chance."""
    first = search.rounds[0]
    return min((one.p_value(first.null_distribution) for one in first.hypotheses), default=1.0)


def _build_change(finding: Finding, first_fit: Refit) -> Change:
    """Build the change of an effect; one that the first log does not show counts as absent there."""
    known, kind, values = _find_in_first_log(finding, first_fit), BY_NAME[finding.effect], {}
    for name, after in finding.parameters.items():
        given = kind.default(name) if after.model_value is None else after.model_value
        before = known.get(name, Estimate(given, None, after.unit))
        after = replace(after, model_value=None)
        values[name] = (before, after, subtract_estimates(before, after))
    return Change(finding.effect, finding.scope, values, finding.p_value, finding.where)


def _find_in_first_log(finding: Finding, first_fit: Refit) -> Mapping[str, Estimate]:
    """Return the parameters of an effect that the first log shows, of its node or of all; empty otherwise."""
    for scope in (finding.scope, ALL):
        for term in first_fit.free_terms:
            if term.key == (finding.effect, scope):
                return estimate_parameters(term, first_fit)
    return {}


def _is_significant(finding: Finding, term: ModelTerm, first_fit: Refit) -> bool:
    """Return True if a parameter differs by more than fits to two drives of an unchanged vehicle do.

    term: the effect in the second log

    The first log may have an effect that it shows too little to name, which is no change then: it is fitted
    beside the others, in the coordinates that the second log determines. Changes of effects on scatter are
    judged by their detectors.
    """
    if not term.is_refittable:
        return True
    known = _find_in_first_log(finding, first_fit)
    if not known:
        fit = refit(first_fit.evaluation.with_state(first_fit.state.with_term(term)), _FIRST_LOG_ROUNDS)
        known = estimate_parameters(next(own for own in fit.free_terms if own.key == term.key), fit)
    return any(
        change.sigma is not None
        and abs(change.value) > _MIN_CHANGE_SIGMA * change.sigma
        and abs(change.value) > _MIN_CHANGE_SCALES * term.effect.scale(name)
        for name, after in finding.parameters.items()
        for change in (subtract_estimates(known[name], after),)
    )
