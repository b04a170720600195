"""Scaffolding: the dependence that fits a residual best, as the class of a new effect, fitted to the log."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import log
from pathlib import Path

from hubodo.effects import BY_NAME
from hubodo.effects.empirical import PREFIX
from hubodo.gap.explain.descriptions import describe_where
from hubodo.gap.explain.finding import estimate_parameters
from hubodo.gap.explain.scaffold import Scaffold
from hubodo.gap.explain.summary import format_with_sigma
from hubodo.gap.judge.search import SearchResult
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.process_noise.residual import compute_gap
from hubodo.gap.process_noise.tracking import track_wheel_phase
from hubodo.gap.refit.linear_fit import Refit
from hubodo.gap.refit.refit import compute_gain, fit_tracked, refit, refit_with_weights
from hubodo.gap.scaffold.scan import Dependence, scan_dependences
from hubodo.gap.scaffold.source import Observation, Summand, compile_effect, render_source
from hubodo.gap.state.state import State
from hubodo.gap.state.terms import ModelTerm

# Largest number of summands; dependences fitted for each; ln Bayes factor required of the first and of each
# further summand.
_MAX_SUMMANDS, _MAX_FITTED, _MIN_FIRST_EVIDENCE, _MIN_FURTHER_EVIDENCE = 3, 8, 10.0, 20.0
# Sigmas from which on a parameter is significant.
_CLEAR_SIGMAS = 3.0
# Number of existing effects that may imitate the new one, and of dependences tried instead of each.
_MAX_REPLACEABLE, _MAX_INSTEAD = 3, 4


@dataclass(frozen=True)
class _Attempt:
    """A fitted class with given summands; `evidence`: ln Bayes factor against the previous attempt."""

    summands: tuple[Summand, ...]
    term: ModelTerm
    refit: Refit
    evidence: float
    replaced: tuple[str, ...]


def build_scaffold(result: SearchResult, name: str, log: Path) -> Scaffold | None:
    """Build the effect `name` from the unexplained residual of `log`; None if nothing is significant."""
    state = result.final.state
    listed_terms = [term for term in state.terms if not term.effect.name.startswith(PREFIX)]
    initial_fit = refit_with_weights(state.reset_with_terms(listed_terms))
    attempt: _Attempt | None = None
    for _ in range(_MAX_SUMMANDS):
        better = _add_summand(initial_fit, attempt, name)
        if better is None:
            break
        attempt = better
    if attempt is None:
        return None
    fit = refit_with_weights(attempt.refit.state)
    evaluation_without = fit.evaluation.with_state(_without(fit.state, name))
    evaluation_without = refit(evaluation_without, rounds=2).evaluation
    term = next(term for term in fit.free_terms if term.effect.name == name)
    values = estimate_parameters(term, fit)
    where = describe_where(evaluation_without.residuals, fit.evaluation.residuals)
    usual_sizes = {key: abs(estimate.value) + (estimate.sigma or 0.0) for key, estimate in values.items()}
    initial_values = {f"{key}=": estimate.value for key, estimate in values.items()}
    value_texts = {
        key: f"{format_with_sigma(estimate.value, estimate.sigma)} {estimate.unit}"
        for key, estimate in values.items()
    }
    observation = Observation(
        log.absolute(), term.scope, where, value_texts, {**usual_sizes, **initial_values}
    )
    return Scaffold(
        name,
        term.scope,
        render_source(name, attempt.summands, observation),
        where,
        values,
        compute_gap(evaluation_without.residuals),
        compute_gap(fit.evaluation.residuals),
        attempt.replaced,
    )


def _without(state: State, name: str) -> State:
    return state.with_terms([term for term in state.terms if term.effect.name != name])


def _add_summand(initial_fit: Refit, best: _Attempt | None, name: str) -> _Attempt | None:
    """Return the best class with one more summand; None if none is significant."""
    point = (initial_fit if best is None else best.refit).evaluation
    summands_before = () if best is None else best.summands
    promising = _list_promising(point, None if best is None else best.term.scope)
    candidates = []
    for one in promising:
        summands = (*summands_before, Summand(one.shape, one.targets))
        effect_class = compile_effect(name, summands)
        start = effect_class() if best is None else effect_class(**best.term.effect.values())
        candidates.append((summands, ModelTerm(start, one.scope)))
    if not candidates:
        return None
    base = initial_fit if best is None else best.refit
    fits = [
        refit(base.evaluation.with_state(_without(base.state, name).with_term(term)))
        for _, term in candidates
    ]
    tracked = [track_wheel_phase(fit.state) for fit in fits]
    all_walks = [base.evaluation.weights.wheel_walks, *(walks_of_fit for _, walks_of_fit in tracked)]
    smallest_walks = {node: min(walks_of_fit[node] for walks_of_fit in all_walks) for node in all_walks[0]}
    weights = replace(base.evaluation.weights, wheel_walks=smallest_walks)
    reference = refit(Evaluation(base.state, weights), rounds=1)
    attempts = []
    for (summands, term), (state, _) in zip(candidates, tracked, strict=True):
        fit = fit_tracked(Evaluation(state, weights), rounds=2)
        added_coordinates = len(term.effect.coordinates()) - (
            len(best.term.effect.coordinates()) if best else 0
        )
        evidence = compute_gain(reference, fit) / fit.tempering - _refit_cost(fit, added_coordinates)
        attempts.append(_prune_effects(_Attempt(summands, term, fit, evidence, ())))
    winner = max(attempts, key=lambda attempt: attempt.evidence)
    if winner.evidence < (_MIN_FIRST_EVIDENCE if best is None else _MIN_FURTHER_EVIDENCE):
        return None
    fitted = next(term for term in winner.refit.free_terms if term.key == winner.term.key)
    return replace(winner, term=fitted, replaced=((best.replaced if best else ()) + winner.replaced))


def _list_promising(evaluation: Evaluation, scope: str | None) -> list[Dependence]:
    """Return dependences to fit, in addition to the model and instead of each of its effects.

    scope: scope of the dependences; None for any
    """
    listed = [term for term in evaluation.state.terms if term.is_refittable and term.effect.name in BY_NAME]
    dependences = _drop_duplicates(scan_dependences(evaluation), scope, _MAX_FITTED)
    for term in listed[:_MAX_REPLACEABLE]:
        other_terms = [other for other in evaluation.state.terms if other.key != term.key]
        without = refit(evaluation.with_state(evaluation.state.with_terms(other_terms)), rounds=1).evaluation
        dependences += _drop_duplicates(scan_dependences(without), scope, _MAX_INSTEAD)
    return _drop_duplicates(dependences, scope, len(dependences))


def _drop_duplicates(dependences: Sequence[Dependence], scope: str | None, maximum: int) -> list[Dependence]:
    """Return the best dependence for each shape and kind of target."""
    best_by_kind: dict[tuple[str, ...], Dependence] = {}
    for dependence in dependences:
        key = (
            dependence.shape.weight,
            dependence.shape.description,
            dependence.scope,
            *(target.name for target in dependence.targets),
        )
        if scope in (None, dependence.scope):
            best_by_kind.setdefault(key, dependence)
    return list(best_by_kind.values())[:maximum]


def _prune_effects(attempt: _Attempt) -> _Attempt:
    """Drop the effects that the attempt makes unnecessary: each costs more than it gains."""
    fit, evidence = attempt.refit, attempt.evidence
    replaced: list[str] = []
    for term in [term for term in fit.free_terms if term.key != attempt.term.key]:
        other_terms = fit.state.with_terms([other for other in fit.state.terms if other.key != term.key])
        without = fit_tracked(Evaluation(track_wheel_phase(other_terms)[0], fit.evaluation.weights), rounds=2)
        saved_cost = (
            _refit_cost(fit, _count_significant(term, fit)) - compute_gain(without, fit) / fit.tempering
        )
        if saved_cost > 0.0:
            fit, evidence = without, evidence + saved_cost
            replaced.append(term.effect.name)
    return replace(attempt, refit=fit, evidence=evidence, replaced=tuple(replaced))


def _count_significant(term: ModelTerm, fit: Refit) -> int:
    """Return the number of significant coordinates; counting all would favour the alternative."""
    values = estimate_parameters(term, fit).values()
    return max(
        1,
        sum(
            estimate.sigma is not None and abs(estimate.value) > _CLEAR_SIGMAS * estimate.sigma
            for estimate in values
        ),
    )


def _refit_cost(fit: Refit, n_coordinates: int) -> float:
    """Return the Occam factor of coordinates determined by all samples, as in BIC."""
    samples = sum(len(node.t) for node in fit.evaluation.problem.nodes)
    return 0.5 * n_coordinates * log(samples / 4.0) + 3.0
