"""The effect that a log asks for and no list has: the dependence that fits best, as a class, fitted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from math import log
from pathlib import Path
from typing import Any

from hubodo.effects import BY_NAME
from hubodo.effects.empirical import PREFIX
from hubodo.gap.explain.descriptions import describe_where
from hubodo.gap.explain.finding import estimate_parameters
from hubodo.gap.explain.result import Estimate
from hubodo.gap.explain.summary import format_with_sigma
from hubodo.gap.judge.search import SearchResult
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.process_noise.residual import compute_gap
from hubodo.gap.process_noise.tracking import track_wheel_phase
from hubodo.gap.refit.refit import Refit, compute_gain, fit_tracked, refit, refit_with_weights
from hubodo.gap.scaffold.scan import Dependence, scan_dependences
from hubodo.gap.scaffold.source import Observation, Summand, compile_effect, render_source
from hubodo.gap.state.state import State
from hubodo.gap.state.terms import ModelTerm

# Terms at most; dependences that are fitted for each; ln Bayes factor that the first one, and each further
# one, has to bring.
_MAX_SUMMANDS, _MAX_FITTED, _MIN_FIRST_EVIDENCE, _MIN_FURTHER_EVIDENCE = 3, 8, 10.0, 20.0
# Sigmas from which on a parameter is at work.
_CLEAR_SIGMAS = 3.0
# Names that may stand in for it, and dependences that are tried in the place of each.
_MAX_REPLACEABLE, _MAX_INSTEAD = 3, 4


@dataclass(frozen=True)
class Scaffold:
    """An effect that was made: the text of its file, its values, the gap without and with it.

    replaced: names that it explains better than they did.
    """

    name: str
    scope: str
    source: str
    where: str
    parameters: Mapping[str, Estimate]
    gap_before: float
    gap_after: float
    replaced: tuple[str, ...]

    def describe(self) -> list[str]:
        """What was made, one line each."""
        values = ", ".join(
            f"{key} {format_with_sigma(it.value, it.sigma)} {it.unit}" for key, it in self.parameters.items()
        )
        lines = [f"{self.name} ({self.scope}): {values}", f"  {self.where}"]
        lines.append(
            f"  gap {self.gap_before:.3f} → {self.gap_after:.3f}; use it with --effects {self.name}.py"
        )
        if self.replaced:
            lines.append(f"  it explains what {', '.join(self.replaced)} stood for")
        return lines

    def as_json(self) -> dict[str, Any]:
        """As `--json` has it."""
        return {
            "effect": self.name,
            "scope": self.scope,
            "parameters": {key: asdict(it) for key, it in self.parameters.items()},
            "where": self.where,
            "gap": {"before": self.gap_before, "after": self.gap_after},
            "replaced": list(self.replaced),
        }


@dataclass(frozen=True)
class _Attempt:
    """A class of so many summands, fitted; evidence: over the point it began from."""

    summands: tuple[Summand, ...]
    term: ModelTerm
    refit: Refit
    evidence: float
    replaced: tuple[str, ...]


def build_scaffold(result: SearchResult, name: str, log: Path) -> Scaffold | None:
    """The effect `name` of what no listed effect explains in `log`; None where nothing is left."""
    state = result.final.state
    kept = [term for term in state.terms if not term.effect.name.startswith(PREFIX)]
    begin = refit_with_weights(state.untracked_with_terms(kept))
    best: _Attempt | None = None
    for _ in range(_MAX_SUMMANDS):
        further = _add_summand(begin, best, name)
        if further is None:
            break
        best = further
    if best is None:
        return None
    made = refit_with_weights(best.refit.state)
    before = made.evaluation.with_state(_without(made.state, name))
    before = refit(before, rounds=2).evaluation
    term = next(term for term in made.free_terms if term.effect.name == name)
    values = estimate_parameters(term, made)
    words = describe_where(before.residuals, made.evaluation.residuals)
    usual = {key: abs(it.value) + (it.sigma or 0.0) for key, it in values.items()}
    places = {f"{key}=": it.value for key, it in values.items()}
    told = {key: f"{format_with_sigma(it.value, it.sigma)} {it.unit}" for key, it in values.items()}
    seen = Observation(log.absolute(), term.scope, words, told, {**usual, **places})
    return Scaffold(
        name,
        term.scope,
        render_source(name, best.summands, seen),
        words,
        values,
        compute_gap(before.residuals),
        compute_gap(made.evaluation.residuals),
        best.replaced,
    )


def _without(state: State, name: str) -> State:
    return state.with_terms([term for term in state.terms if term.effect.name != name])


def _add_summand(begin: Refit, best: _Attempt | None, name: str) -> _Attempt | None:
    """The best class of one summand more; None where none earns it."""
    point = (begin if best is None else best.refit).evaluation
    before = () if best is None else best.summands
    promising = _list_promising(point, None if best is None else best.term.scope)
    tried = []
    for one in promising:
        summands = (*before, Summand(one.shape, one.targets))
        kind = compile_effect(name, summands)
        start = kind() if best is None else kind(**best.term.effect.values())
        tried.append((summands, ModelTerm(start, one.scope)))
    if not tried:
        return None
    base = begin if best is None else best.refit
    fits = [
        refit(base.evaluation.with_state(_without(base.state, name).with_term(term))) for _, term in tried
    ]
    tracked = [track_wheel_phase(it.state) for it in fits]
    walks = [base.evaluation.weights.wheel_walks, *(own for _, own in tracked)]
    least = {node: min(own[node] for own in walks) for node in walks[0]}
    weights = replace(base.evaluation.weights, wheel_walks=least)
    plain = refit(Evaluation(base.state, weights), rounds=1)
    attempts = []
    for (summands, term), (state, _) in zip(tried, tracked, strict=True):
        made = fit_tracked(Evaluation(state, weights), rounds=2)
        grown = len(term.effect.coordinates()) - (len(best.term.effect.coordinates()) if best else 0)
        evidence = compute_gain(plain, made) / made.tempering - _refit_cost(made, grown)
        attempts.append(_prune_effects(_Attempt(summands, term, made, evidence, ())))
    winner = max(attempts, key=lambda it: it.evidence)
    if winner.evidence < (_MIN_FIRST_EVIDENCE if best is None else _MIN_FURTHER_EVIDENCE):
        return None
    fitted = next(term for term in winner.refit.free_terms if term.key == winner.term.key)
    return replace(winner, term=fitted, replaced=((best.replaced if best else ()) + winner.replaced))


def _list_promising(point: Evaluation, scope: str | None) -> list[Dependence]:
    """What is worth a fit: beside all that is in the model, and in the place of each name that was found.

    scope: the one that it must have.
    """
    named = [term for term in point.state.terms if term.is_refittable and term.effect.name in BY_NAME]
    found = _drop_duplicates(scan_dependences(point), scope, _MAX_FITTED)
    for term in named[:_MAX_REPLACEABLE]:
        less = [other for other in point.state.terms if other.key != term.key]
        without = refit(point.with_state(point.state.with_terms(less)), rounds=1).evaluation
        found += _drop_duplicates(scan_dependences(without), scope, _MAX_INSTEAD)
    return _drop_duplicates(found, scope, len(found))


def _drop_duplicates(found: Sequence[Dependence], scope: str | None, maximum: int) -> list[Dependence]:
    """The best of each shape on each kind of target."""
    made: dict[tuple[str, ...], Dependence] = {}
    for one in found:
        key = (one.shape.weight, one.shape.description, one.scope, *(target.name for target in one.targets))
        if scope in (None, one.scope):
            made.setdefault(key, one)
    return list(made.values())[:maximum]


def _prune_effects(attempt: _Attempt) -> _Attempt:
    """Without the names that it does the work of: each costs more than it then brings."""
    made, evidence = attempt.refit, attempt.evidence
    replaced: list[str] = []
    for term in [term for term in made.free_terms if term.key != attempt.term.key]:
        less = made.state.with_terms([other for other in made.state.terms if other.key != term.key])
        without = fit_tracked(Evaluation(track_wheel_phase(less)[0], made.evaluation.weights), rounds=2)
        saved = (
            _refit_cost(made, _count_significant(term, made)) - compute_gain(without, made) / made.tempering
        )
        if saved > 0.0:
            made, evidence = without, evidence + saved
            replaced.append(term.effect.name)
    return replace(attempt, refit=made, evidence=evidence, replaced=tuple(replaced))


def _count_significant(term: ModelTerm, made: Refit) -> int:
    """How many of a term's coordinates are clearly not zero; to count all would favour any other."""
    values = estimate_parameters(term, made).values()
    return max(1, sum(it.sigma is not None and abs(it.value) > _CLEAR_SIGMAS * it.sigma for it in values))


def _refit_cost(made: Refit, free: int) -> float:
    """Occam's factor of so many coordinates that all samples fix, as in BIC."""
    samples = sum(len(node.t) for node in made.evaluation.problem.nodes)
    return 0.5 * free * log(samples / 4.0) + 3.0
