"""Changes between two logs of one vehicle: effects, their size, and the p-value of no change."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from hubodo.effects import BY_NAME
from hubodo.effects.empirical import PREFIX
from hubodo.errors import InputError
from hubodo.gap.change.estimates import estimate_change
from hubodo.gap.change.given_model import FIRST_LOG_SHARE, is_remounted, judge_second_log, model_of_fit
from hubodo.gap.change.joint import EffectKey
from hubodo.gap.change.result import CHANGE_P_VALUE, Change, ChangeResult, subtract_estimates
from hubodo.gap.change.score_test import compare_logs
from hubodo.gap.change.search import PairSearchResult, search_changes
from hubodo.gap.explain.descriptions import describe_where
from hubodo.gap.explain.result import Estimate
from hubodo.gap.judge.hypothesis import Hypothesis
from hubodo.gap.judge.round import ReportProgress
from hubodo.gap.judge.search import SearchObserver, build_initial_state, search_effects
from hubodo.gap.problem.build import build_problem
from hubodo.gap.problem.problem import Problem
from hubodo.gap.refit.linear_fit import Refit
from hubodo.gap.refit.prior import MIN_GIVEN_TEMPERING
from hubodo.gap.refit.prune import prune_coordinates
from hubodo.gap.screen.null_distribution import NullDistribution
from hubodo.gap.screen.unnamed_terms import find_unnamed_terms
from hubodo.gap.state.state import State
from hubodo.gap.state.terms import ModelTerm, model_of_terms
from hubodo.model.model_file import Model
from hubodo.recording import Recording

# Tempering above which residuals are so correlated that only held-out samples count as evidence.
_MIN_CORRELATED_TEMPERING = 3.0
# ln Bayes factor of an unnamed term, tempered, and ratio of its gain in the second log to that in the first.
_MIN_UNNAMED_CHANGE_EVIDENCE, _MIN_UNNAMED_CHANGE_GAIN_RATIO = 6.0, 4.0
# Smallest difference, in sigma, that is reported for a value that belongs to one drive, such as an offset.
_MIN_DRIVE_CHANGE_SIGMA = 5.0
# Fraction of the reported progress for the comparison.
_COMPARISON_SHARE = 0.35


def find_change(
    before: Recording,
    after: Recording,
    model: Model,
    *,
    log_names: tuple[str, str] = ("before", "after"),
    report_progress: ReportProgress = lambda words, share: None,
) -> ChangeResult:
    """Find the effects whose values differ between two logs of one vehicle.

    The first log is searched for effects that the model lacks. Where its residuals are correlated, as on real
    roads, the second log is judged with the model of the first. In independent residuals, and if a sensor was
    mounted elsewhere, each effect of the model, and each candidate, is fitted with a separate value in the
    second log instead.

    Raises InputError if a log does not belong to the model, or the logs have different nodes.
    """
    problems = [build_problem(log, model, name) for log, name in zip((before, after), log_names, strict=True)]
    names = [{node.name for node in problem.nodes} for problem in problems]
    if names[0] != names[1]:
        raise InputError(
            f"{log_names[0]} has {', '.join(names[0])}, {log_names[1]} has {', '.join(names[1])}: "
            "compare logs with the same nodes"
        )
    first_fit = fit_first_log(problems[0], log_names[0], report_progress)
    return compare_with_first_log(first_fit, after, log_names[1], report_progress)


def fit_first_log(
    problem: Problem, log_name: str = "before", report_progress: ReportProgress = lambda words, share: None
) -> Refit:
    """Search the first log for the effects that its model lacks, and return their fit."""
    observer = SearchObserver(
        report_progress=lambda words, share: report_progress(f"{log_name}, {words}", FIRST_LOG_SHARE * share)
    )
    return prune_coordinates(search_effects(build_initial_state(problem), observer=observer).final)


def compare_with_first_log(
    first_fit: Refit,
    after: Recording,
    log_name: str = "after",
    report_progress: ReportProgress = lambda words, share: None,
) -> ChangeResult:
    """Find the effects whose values differ in the second log; first_fit: from `fit_first_log`."""
    if first_fit.tempering > MIN_GIVEN_TEMPERING:
        problem = build_problem(after, model_of_fit(first_fit), log_name)
        if not is_remounted(problem):
            return judge_second_log(first_fit, problem, log_name, report_progress)
    problem = build_problem(after, first_fit.state.problem.model, log_name)
    return _compare_jointly(first_fit, problem, report_progress)


def _compare_jointly(
    first_fit: Refit, second_problem: Problem, report_progress: ReportProgress
) -> ChangeResult:
    """Compare two logs by a joint fit."""
    problems = (first_fit.state.problem, second_problem)
    model = problems[0].model
    states = _build_states(problems, first_fit.state)
    searched = search_changes(
        states,
        [term.key for term in states[0].terms if _is_of_drive(term)],
        first_fit.tempering,
        lambda words, share: report_progress(
            f"comparing the logs, {words}", FIRST_LOG_SHARE + _COMPARISON_SHARE * share
        ),
    )
    report_progress("comparing the logs by chance", FIRST_LOG_SHARE + _COMPARISON_SHARE)
    is_correlated = max(fit.tempering for fit in searched.last.fits) > _MIN_CORRELATED_TEMPERING
    separate = searched.first.separate
    comparison = compare_logs(*searched.first.evaluations, separate)
    null_distribution = comparison.null_distribution
    if searched.changes:
        null_distribution = compare_logs(*searched.last.evaluations, separate).null_distribution
    is_significant = comparison.p_value < CHANGE_P_VALUE
    changes = _list_changes(searched, null_distribution)
    if not is_significant and not is_correlated:
        # The p-value is that of the channel means.
        changes = tuple(one for one in changes if BY_NAME[one.effect].visible_in == "scatter")
    unnamed = _list_unnamed(searched) if is_significant and not is_correlated else ()
    warnings = tuple(dict.fromkeys(warning for problem in problems for warning in problem.warnings))
    models = [model_of_terms(model, fit.state.terms) for fit in searched.last.fits]
    return ChangeResult(comparison.p_value, changes, unnamed, models[0], models[1], warnings, is_correlated)


def _build_states(problems: Sequence[Problem], estimate: State) -> tuple[State, State]:
    """Return the states of both logs with the effects that were found in the first, without unnamed terms."""
    terms = [term for term in estimate.terms if not term.effect.name.startswith(PREFIX)]
    first = replace(estimate, problem=problems[0]).reset_with_terms(terms)
    second = replace(build_initial_state(problems[1]), has_steady_wheels=estimate.has_steady_wheels)
    return first, second.with_terms(terms)


def _is_of_drive(term: ModelTerm) -> bool:
    """Return True for a term of the channel means whose value belongs to one drive, such as an offset."""
    return term.effect.varies_between_drives and term.effect.visible_in == "mean"


def _list_changes(searched: PairSearchResult, null_distribution: NullDistribution) -> tuple[Change, ...]:
    """Return the changes, those of the vehicle first."""
    changes = [_build_change(one, searched, null_distribution) for one in searched.changes]
    searched_keys = {one.key for one in searched.changes}
    of_drive = [key for key in sorted(searched.first.separate) if key not in searched_keys]
    changes += [change for key in of_drive for change in _list_drive_changes(key, searched)]
    return tuple(sorted(changes, key=lambda change: change.belongs_to_drive))


def _build_change(one: Hypothesis, searched: PairSearchResult, null_distribution: NullDistribution) -> Change:
    """Build a change that the search found."""
    p_value = one.p_value(null_distribution)
    if one.proposal is not None:
        sigmas = one.proposal.sigmas
        before = next((term for term in searched.last.fits[0].state.terms if term.key == one.key), None)
        values = {}
        for name, value in one.term.effect.values().items():
            unit = one.term.effect.unit(name)
            value_before = before.effect.values()[name] if before else type(one.term.effect).default(name)
            pair = (Estimate(value_before, None, unit), Estimate(value, sigmas.get(name), unit))
            values[name] = (*pair, subtract_estimates(*pair))
        return Change(*one.key, values, p_value, one.proposal.where)
    return Change(*one.key, estimate_change(searched.last, one.key), p_value, _where(one.key, searched))


def _where(key: EffectKey, searched: PairSearchResult) -> str:
    """Return channels and regimes of the second log that show a change."""
    fits = searched.last.fits
    old = [term for term in fits[0].state.terms if term.key == key]
    evaluation = fits[1].without_cache().evaluation
    terms = [*(term for term in evaluation.state.terms if term.key != key), *old]
    unchanged = evaluation.with_state(evaluation.state.with_terms(terms))
    return describe_where(unchanged.residuals, evaluation.residuals)


def _list_drive_changes(key: EffectKey, searched: PairSearchResult) -> list[Change]:
    """Return the change of an effect whose value belongs to one drive, if it is significant."""
    values = estimate_change(searched.last, key)
    ratios = [
        abs(change.value) / change.sigma for _, _, change in values.values() if change.sigma is not None
    ]
    if not any(ratio > _MIN_DRIVE_CHANGE_SIGMA for ratio in ratios):
        return []
    p_value = math.erfc(max(ratios) / math.sqrt(2.0))
    return [Change(*key, values, p_value, "each drive has a value of its own")]


def _list_unnamed(searched: PairSearchResult) -> tuple[str, ...]:
    """Return the unnamed terms that only the second log requires."""
    before, after = (find_unnamed_terms(one) for one in searched.last.evaluations)
    earlier = {one.term.key: one.gain for one in before}
    return tuple(
        one.term.effect.name
        for one in after
        if one.evidence > _MIN_UNNAMED_CHANGE_EVIDENCE
        and one.gain > _MIN_UNNAMED_CHANGE_GAIN_RATIO * earlier.get(one.term.key, 0.0)
    )
