"""Workflow of a search: search, reconsider each effect, measure the gap on held-out samples."""

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

# Ratio of the final gap to that of noise alone, from which on the log is not fully explained.
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
    """Find the effects missing in a model to explain a log; see `find_problem_gap`.

    Raises InputError if the log lacks an input of the model.
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
    """Find the effects missing in the model of a problem.

    accept: effects added before the search starts
    reject: effects not considered
    report_progress: called with the activity and the completed share, which never decreases
    journal: stores the rounds, and provides those of an interrupted search. With a journal, a
        KeyboardInterrupt ends the search with its intermediate result, if there is one
    """
    report_progress = _hold_share(report_progress)
    report_progress("tracking the wheels", 0.0)
    initial_state, results = build_initial_state(problem), list[SearchResult]()
    observer = SearchObserver(journal or Journal(), report_progress, results.append)
    try:
        results.append(search_effects(initial_state, accept, reject, observer))
        result, rounds = reconsider_effects(results[-1], accept, reject, observer)
        result, rounds = drop_chance_effects(result, rounds, accept)
        result = replace(result, final=result.final.without_cache())
    except KeyboardInterrupt:
        if journal is None or not results:
            raise
        return _build_unfinished_result(initial_state, results[-1], report_progress)
    report_progress("measuring on held-out samples", 0.9)
    effects = {term.effect.name for term in result.final.state.terms}
    ineffective = [f"{name}: accepted, but not visible in this log" for name in accept if name not in effects]
    return _build_result(initial_state, result, rounds, (*problem.warnings, *ineffective))


def _hold_share(report_progress: ReportProgress) -> ReportProgress:
    """Return a callback that reports the largest share so far.

    The number of rounds is not known in advance: the search of all samples begins again at the round that the
    decimated search began at, and a reconsideration that drops an effect begins again at the first.
    """
    largest = 0.0

    def report(words: str, share: float) -> None:
        nonlocal largest
        largest = max(largest, share)
        report_progress(words, largest)

    return report


def _build_unfinished_result(
    initial_state: State, result: SearchResult, report_progress: ReportProgress
) -> GapResult:
    """Return the result of an interrupted search, without reconsideration."""
    report_progress("interrupted; measuring the effects found so far", 0.9)
    rounds = {judged.best.key: judged for judged in result.rounds if judged.best is not None}
    full_state = replace(initial_state, problem=result.final.state.problem)
    warning = "the search was interrupted: more may be missing, and no effect was reconsidered"
    return replace(
        _build_result(full_state, result, rounds, (*initial_state.problem.warnings, warning)),
        is_finished=False,
    )


def _build_result(
    initial_state: State, search_result: SearchResult, rounds: RoundsByKey, warnings: tuple[str, ...]
) -> GapResult:
    """Build the result: gaps and held-out gaps after each added effect, findings, unexplained residuals."""
    problem, final = initial_state.problem, search_result.final.evaluation.without_cache()
    held_out_split = split_held_out(problem)
    terms = [term for term in final.state.terms if term.is_fitted]
    given = [term for term in final.state.terms if not term.is_fitted]
    stages = [_refit_stage(initial_state, terms[:k], final) for k in range(len(terms))]
    held_out_gaps = [_held_out_gap(stage.without_cache(), held_out_split) for stage in (*stages, final)]
    residuals = [*(stage.without_cache().residuals for stage in stages), final.residuals]
    unexplained_items, has_structure = list_unexplained(final, residuals[-1])
    del final  # Free the cached results of the final evaluation, which are large.
    findings = []
    for k, term in enumerate(terms):
        finding = build_finding(term, search_result, rounds, residuals[k : k + 2], held_out_gaps[k : k + 2])
        findings += split_by_channel(finding) if finding.effect.startswith(PREFIX) else [finding]
    total = BeforeAfter(
        compute_gap(residuals[0]), compute_gap(residuals[-1]), compute_gap_floor(residuals[-1])
    )
    is_unexplained = has_structure or total.after > _MAX_EXPLAINED_GAP_RATIO * compute_gap_floor(
        residuals[-1]
    )
    verdict: Verdict
    if findings:
        verdict = "partly_explained" if is_unexplained else "explained"
    else:
        verdict = "unexplained" if is_unexplained else "no_gap"
    return GapResult(
        verdict,
        total,
        BeforeAfter(held_out_gaps[0], held_out_gaps[-1]),
        held_out_split.kind,
        tuple(findings),
        tuple(unexplained_items),
        warnings,
        _model_with(problem.model, [*given, *terms]),
        search_result,
        tuple(residuals),
    )


def _refit_stage(initial_state: State, terms: Sequence[ModelTerm], final: Evaluation) -> Evaluation:
    """Refit the model with only the first effects."""
    keys = {term.key for term in terms}
    others = [term for term in initial_state.terms if term.key not in keys]
    return refit(
        final.with_state(initial_state.with_terms([*others, *terms])), rounds=2
    ).evaluation.without_cache()


def _held_out_gap(evaluation: Evaluation, held_out_split: HeldOutSplit) -> float:
    """Return the gap on held-out samples, with the terms fitted to the others."""
    trained = refit(
        replace(evaluation, weights=held_out_split.exclude_from(evaluation.weights)), rounds=2
    ).without_cache()
    return compute_gap(evaluation.with_state(trained.state).residuals, held_out_split.masks)


def _model_with(model: Model, terms: Sequence[ModelTerm]) -> Model:
    scoped = [
        ScopedEffect(term.effect, None if term.scope in (ALL, VEHICLE) else term.scope) for term in terms
    ]
    return replace(model, effects=()).with_effects(*scoped)
