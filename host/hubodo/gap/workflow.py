"""Workflow of `hubodo gap`: search, reconsideration of each effect, gap on held-out samples."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

from hubodo.effects import BY_NAME, Effect
from hubodo.effects.empirical import PREFIX
from hubodo.gap.explain.finding import build_finding
from hubodo.gap.explain.missing_effects import MissingEffects
from hubodo.gap.explain.result import BeforeAfter, Finding, Verdict, split_by_channel
from hubodo.gap.explain.unexplained import list_unexplained
from hubodo.gap.judge.chance_effects import drop_chance_effects
from hubodo.gap.judge.held_out import HeldOutResidual, HeldOutSplit, measure_held_out, split_held_out
from hubodo.gap.judge.journal import Journal
from hubodo.gap.judge.reconsider import reconsider_effects
from hubodo.gap.judge.round import ReportProgress, RoundsByKey
from hubodo.gap.judge.search import SearchObserver, SearchResult, build_initial_state, search_effects
from hubodo.gap.judge.small_effects import search_small_effects
from hubodo.gap.problem.build import build_problem
from hubodo.gap.problem.problem import Problem
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.process_noise.residual import Residual, compute_gap, compute_gap_floor
from hubodo.gap.refit.prune import prune_coordinates
from hubodo.gap.refit.refit import refit, refit_with_weights
from hubodo.gap.state.state import State
from hubodo.gap.state.terms import ModelTerm, hold_given, model_of_terms
from hubodo.model.model_file import Model
from hubodo.recording import Recording

# Largest change of an effect of the model, in usual sizes, that is no finding where residuals are correlated.
_MAX_MINOR_CHANGE, _MIN_REFINEMENT_TEMPERING = 0.25, 2.0
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
) -> MissingEffects:
    """Find the effects that a model lacks to explain a log; arguments as in `find_problem_gap`.

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
    has_steady_wheels: bool = False,
    report_progress: ReportProgress = lambda words, share: None,
    journal: Journal | None = None,
) -> MissingEffects:
    """Find the effects that the model of a problem lacks.

    accept: effects added before the search starts
    reject: effects not considered
    has_steady_wheels: True to separate trends of wheel phases from their walks from the start
    report_progress: called with the activity and the completed share, which never decreases
    journal: stores the rounds, and provides those of an interrupted search. With a journal, a
        KeyboardInterrupt ends the search with its intermediate result, if there is one
    """
    report_progress = _hold_share(report_progress)
    report_progress("tracking the wheels", 0.0)
    initial_state = replace(build_initial_state(problem), has_steady_wheels=has_steady_wheels)
    results = list[SearchResult]()
    observer = SearchObserver(journal or Journal(), report_progress, results.append)
    try:
        results.append(search_effects(initial_state, accept, reject, observer))
        result, rounds = reconsider_effects(results[-1], accept, reject, observer)
        results += [result, search_small_effects(result, reject, observer)]
        # Without a large effect, weights with the correlation of the noise would take it for noise.
        result, rounds = reconsider_effects(results[-1], accept, reject, observer, rounds)
        result, rounds = drop_chance_effects(result, rounds, accept)
        # What is measured and written has the given effects as they are in the model file.
        initial_state = initial_state.with_terms(hold_given(initial_state.terms))
        final_state = result.final.state
        if any(term.is_nuisance for term in final_state.terms):
            held = refit_with_weights(final_state.reset_with_terms(hold_given(final_state.terms)))
            result = replace(result, final=held)
        result = replace(result, final=prune_coordinates(result.final).without_cache())
    except KeyboardInterrupt:
        if journal is None or not results:
            raise
        return _build_unfinished_result(initial_state, results[-1], report_progress)
    report_progress("measuring on held-out samples", 0.9)
    effects = {term.effect.name for term in result.final.state.terms}
    ineffective = [f"{name}: accepted, but not visible in this log" for name in accept if name not in effects]
    return _build_result(initial_state, result, rounds, (*problem.warnings, *ineffective))


def _hold_share(report_progress: ReportProgress) -> ReportProgress:
    """Return a callback for progress that reports the largest fraction so far.

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
) -> MissingEffects:
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
) -> MissingEffects:
    """Build the result: gaps and held-out gaps after each added effect, findings, unexplained residuals.

    If the gap grew, on all or on held-out samples, only the first effects are kept, up to the best gap.
    Refinements of what the model file has are given up before new effects.
    """
    problem, final = initial_state.problem, search_result.final.evaluation.without_cache()
    held_out_split = split_held_out(problem)
    terms = [term for term in final.state.terms if term.is_fitted]
    stages, held_out_gaps, residuals, best = _measure_stages(initial_state, terms, final, held_out_split)
    reordered = _with_refinements_last(initial_state, terms)
    if best < len(terms) and reordered != terms:
        terms = reordered
        stages, held_out_gaps, residuals, best = _measure_stages(initial_state, terms, final, held_out_split)
    if best < len(terms):
        left_out = ", ".join(term.label for term in terms[best:])
        warnings = (*warnings, f"left out, as the gap would grow: {left_out}")
        terms, final = terms[:best], stages[best].without_cache()
        stages, held_out_gaps, residuals = (
            stages[: best + 1],
            held_out_gaps[: best + 1],
            residuals[: best + 1],
        )
        search_result = replace(search_result, final=refit(final, rounds=0))
        final = search_result.final.evaluation
    given = [term for term in final.state.terms if not term.is_fitted]
    unexplained_items, has_structure = list_unexplained(final, residuals[-1])
    del final  # Free the cached results of the final evaluation, which are large.
    findings = []
    for k, term in enumerate(terms):
        finding = build_finding(
            term,
            search_result,
            rounds,
            residuals[k : k + 2],
            held_out_gaps[k : k + 2],
            _given_effect(initial_state, term),
        )
        findings += split_by_channel(finding) if finding.effect.startswith(PREFIX) else [finding]
    is_correlated = search_result.final.tempering > _MIN_REFINEMENT_TEMPERING
    refined = tuple(finding for finding in findings if is_correlated and _is_minor(finding))
    findings = [finding for finding in findings if finding not in refined]
    floor = compute_gap_floor(residuals[0])
    total = BeforeAfter(compute_gap(residuals[0]), compute_gap(residuals[-1]), floor)
    is_unexplained = has_structure or total.after > _MAX_EXPLAINED_GAP_RATIO * floor
    verdict: Verdict
    if findings:
        verdict = "partly_explained" if is_unexplained else "explained"
    else:
        verdict = "unexplained" if is_unexplained else "no_gap"
    return MissingEffects(
        verdict,
        total,
        BeforeAfter(held_out_gaps[0], held_out_gaps[-1]),
        held_out_split.kind,
        tuple(findings),
        tuple(unexplained_items),
        warnings,
        model_of_terms(problem.model, [*given, *terms]),
        search_result,
        tuple(residuals),
        refined=refined,
    )


def _is_minor(finding: Finding) -> bool:
    """Return True if the value of a given effect changes by less than it differs between drives."""
    if finding.effect.startswith(PREFIX) or any(
        one.model_value is None for one in finding.parameters.values()
    ):
        return False
    kind = BY_NAME[finding.effect]
    return all(
        abs(one.value - (one.model_value or 0.0)) < _MAX_MINOR_CHANGE * kind.scale(name)
        for name, one in finding.parameters.items()
    )


def _measure_stages(
    initial_state: State, terms: Sequence[ModelTerm], final: Evaluation, held_out_split: HeldOutSplit
) -> tuple[list[Evaluation], list[float], list[Mapping[str, Residual]], int]:
    """Return evaluation, held-out gap and residuals after each of K effects, and how many effects to keep."""
    stages = [*(_refit_stage(initial_state, terms[:k], final) for k in range(len(terms))), final]
    held_out = [_measure_held_out(stage.without_cache(), held_out_split) for stage in stages]
    residuals = [stage.without_cache().residuals for stage in stages]
    best = _best_stage([compute_gap(one) for one in residuals], held_out)
    return stages, [one.gap for one in held_out], residuals, best


def _with_refinements_last(initial_state: State, terms: Sequence[ModelTerm]) -> list[ModelTerm]:
    """Return the terms with those last whose effect the model file has, otherwise in the same order."""
    given = {term.key for term in initial_state.terms}
    return sorted(terms, key=lambda term: term.key in given)


def _best_stage(gaps: Sequence[float], held_out: Sequence[HeldOutResidual]) -> int:
    """Return how many effects to keep: all, unless the gap grew; then those up to the smallest held-out gap.

    gaps, held_out: (K + 1,) with the first k effects
    """
    allowed = [
        k for k, one in enumerate(held_out) if gaps[k] <= gaps[0] and not one.is_larger_than(held_out[0])
    ]
    last = len(gaps) - 1
    return last if last in allowed else min(allowed, key=lambda k: held_out[k].gap)


def _given_effect(initial_state: State, term: ModelTerm) -> Effect | None:
    """Return the effect of the model file that a term refines, or None."""
    nodes = [node for node in initial_state.problem.nodes if term.acts_on(node)]
    given = {initial_state.effects[node.name].get(type(term.effect)) for node in nodes}
    return next(iter(given)) if len(given) == 1 else None


def _refit_stage(initial_state: State, terms: Sequence[ModelTerm], final: Evaluation) -> Evaluation:
    """Refit the model with only the first few effects."""
    keys = {term.key for term in terms}
    others = [term for term in initial_state.terms if term.key not in keys]
    return refit(
        final.with_state(initial_state.with_terms([*others, *terms])), rounds=2
    ).evaluation.without_cache()


def _measure_held_out(evaluation: Evaluation, held_out_split: HeldOutSplit) -> HeldOutResidual:
    """Return the residual of held-out samples, with the terms fitted to the others."""
    trained = refit(
        replace(evaluation, weights=held_out_split.exclude_from(evaluation.weights)), rounds=2
    ).without_cache()
    return measure_held_out(evaluation.with_state(trained.state).residuals, held_out_split.masks)
