"""The workflow: search, reconsider each name beside its rivals, measure what shrank on data not fitted."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

from hubodo.effects.empirical import PREFIX
from hubodo.gap.explain.finding import build_finding
from hubodo.gap.explain.result import BeforeAfter, GapResult, Verdict, split_by_channel
from hubodo.gap.explain.unexplained import list_unexplained
from hubodo.gap.judge.held_out import HeldOutSplit, split_held_out
from hubodo.gap.judge.journal import Journal
from hubodo.gap.judge.reconsider import RoundsByKey, drop_chance_effects, reconsider_effects
from hubodo.gap.judge.round import ReportProgress
from hubodo.gap.judge.search import SearchObserver, SearchResult, build_initial_state, search_effects
from hubodo.gap.problem.build import build_problem
from hubodo.gap.problem.problem import Problem
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.process_noise.residual import compute_gap, compute_gap_floor
from hubodo.gap.refit.refit import refit
from hubodo.gap.state.state import State
from hubodo.gap.state.terms import ALL, VEHICLE, ModelTerm
from hubodo.model.model_file import Model, ScopedEffect
from hubodo.recording import Recording

# A gap so much larger than that of noise alone is not explained, whatever was found.
_MAX_EXPLAINED_GAP_RATIO = 1.5


def find_gap(
    recording: Recording,
    model: Model,
    *,
    accept: Collection[str] = (),
    reject: Collection[str] = (),
    log_name: str = "log",
    report_progress: ReportProgress = lambda words, share: None,
    journal: Journal | None = None,
) -> GapResult:
    """Where a log and a model disagree, what is missing, and the model with it: see `find_gap_in`.

    Raises InputError when the log has not what the model needs.
    """
    problem = build_problem(recording, model, log_name)
    return find_problem_gap(
        problem, accept=accept, reject=reject, report_progress=report_progress, journal=journal
    )


def find_problem_gap(
    problem: Problem,
    *,
    accept: Collection[str] = (),
    reject: Collection[str] = (),
    report_progress: ReportProgress = lambda words, share: None,
    journal: Journal | None = None,
) -> GapResult:
    """What is missing in the model of a problem, and the model with it. The log itself is not needed for it.

    accept: names of effects that are added before anything is searched. reject: names not considered.
    journal: keeps the rounds of the search, and has those of one that was stopped. With one, a
    KeyboardInterrupt ends the search with what it has found, where it has found anything.
    """
    report_progress("following the wheels", 0.02)
    begin, found = build_initial_state(problem), list[SearchResult]()
    watch = SearchObserver(journal or Journal(), report_progress, found.append)
    try:
        found.append(search_effects(begin, accept, reject, watch))
        last, rounds = reconsider_effects(found[-1], accept, reject, watch)
        last, rounds = drop_chance_effects(last, rounds, accept)
        last = replace(last, final=last.final.without_cache())
    except KeyboardInterrupt:
        if journal is None or not found:
            raise
        return _build_unfinished_result(begin, found[-1], report_progress)
    report_progress("measuring on what was not fitted", 0.9)
    there = {term.effect.name for term in last.final.state.terms}
    unseen = [f"{name}: accepted, but nothing in this log shows it" for name in accept if name not in there]
    return _build_result(begin, last, rounds, (*problem.warnings, *unseen))


def _build_unfinished_result(
    begin: State, result: SearchResult, report_progress: ReportProgress
) -> GapResult:
    """What a search had found when it was stopped, each name as it was found."""
    report_progress("stopped; measuring what was found so far", 0.9)
    rounds = {made.best.key: made for made in result.rounds if made.best is not None}
    here = replace(begin, problem=result.final.state.problem)
    words = "the search was stopped: more may be missing, and no name was looked at a second time"
    return replace(_build_result(here, result, rounds, (*begin.problem.warnings, words)), is_finished=False)


def _build_result(
    begin: State, search_result: SearchResult, rounds: RoundsByKey, warnings: tuple[str, ...]
) -> GapResult:
    problem, final = begin.problem, search_result.final.evaluation.without_cache()
    held = split_held_out(problem)
    terms = [term for term in final.state.terms if term.is_fitted]
    given = [term for term in final.state.terms if not term.is_fitted]
    stages = [_refit_stage(begin, terms[:k], final) for k in range(len(terms))]
    outside = [_held_out_gap(one.without_cache(), held) for one in (*stages, final)]
    steps = [*(one.without_cache().residuals for one in stages), final.residuals]
    left, structured = list_unexplained(final, steps[-1])
    del final  # What was worked out of it is large.
    findings = []
    for k, term in enumerate(terms):
        one = build_finding(term, search_result, rounds, steps[k : k + 2], outside[k : k + 2])
        findings += split_by_channel(one) if one.effect.startswith(PREFIX) else [one]
    whole = BeforeAfter(compute_gap(steps[0]), compute_gap(steps[-1]), compute_gap_floor(steps[-1]))
    unexplained = structured or whole.after > _MAX_EXPLAINED_GAP_RATIO * compute_gap_floor(steps[-1])
    verdict: Verdict
    if findings:
        verdict = "partly_explained" if unexplained else "explained"
    else:
        verdict = "unexplained" if unexplained else "no_gap"
    return GapResult(
        verdict,
        whole,
        BeforeAfter(outside[0], outside[-1]),
        held.kind,
        tuple(findings),
        tuple(left),
        warnings,
        _model_with(problem.model, [*given, *terms]),
        search_result,
        tuple(steps),
    )


def _refit_stage(begin: State, terms: Sequence[ModelTerm], final: Evaluation) -> Evaluation:
    """The model as it was with only the first effects found, fitted anew."""
    keys = {term.key for term in terms}
    kept = [term for term in begin.terms if term.key not in keys]
    return refit(final.with_state(begin.with_terms([*kept, *terms])), rounds=2).evaluation.without_cache()


def _held_out_gap(point: Evaluation, held: HeldOutSplit) -> float:
    """The gap on what was held out, with the terms fitted to the rest."""
    trained = refit(replace(point, weights=held.exclude_from(point.weights)), rounds=2).without_cache()
    return compute_gap(point.with_state(trained.state).residuals, held.masks)


def _model_with(model: Model, terms: Sequence[ModelTerm]) -> Model:
    scoped = [
        ScopedEffect(term.effect, None if term.scope in (ALL, VEHICLE) else term.scope) for term in terms
    ]
    return replace(model, effects=()).with_effects(*scoped)
