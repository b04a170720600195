"""The effect that a log asks for and no list has: the dependence that fits best, as a class, fitted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from math import log
from pathlib import Path
from typing import Any

from hubodo.effects import BY_NAME
from hubodo.effects.empirical import PREFIX
from hubodo.gap.judge.search import SearchResult
from hubodo.gap.process_noise.point import Point
from hubodo.gap.process_noise.residual import gap
from hubodo.gap.process_noise.tracking import track_wheel_phase
from hubodo.gap.refit.refit import Refit, fit_tracked, gain_over, refit, refit_with_weights
from hubodo.gap.scaffold.scan import Dependence, scan
from hubodo.gap.scaffold.source import SeenIn, Summand, as_class, source
from hubodo.gap.state.state import State
from hubodo.gap.state.terms import ModelTerm
from hubodo.gap.tell.account import with_sigma
from hubodo.gap.tell.finding import fitted_values
from hubodo.gap.tell.result import Value
from hubodo.gap.tell.words import where_words

# Terms at most; dependences that are fitted for each; ln Bayes factor that the first one, and each further
# one, has to bring.
_TERMS, _FITTED, _FIRST, _FURTHER = 3, 8, 10.0, 20.0
# Sigmas from which on a parameter is at work.
_CLEAR = 3.0
# Names that may stand in for it, and dependences that are tried in the place of each.
_STANDING_IN, _INSTEAD = 3, 4


@dataclass(frozen=True)
class Scaffold:
    """An effect that was made: the text of its file, its values, the gap without and with it.

    replaced: names that it explains better than they did.
    """

    name: str
    scope: str
    text: str
    where: str
    values: Mapping[str, Value]
    gap_before: float
    gap_after: float
    replaced: tuple[str, ...]

    def words(self) -> list[str]:
        """What was made, one line each."""
        values = ", ".join(
            f"{key} {with_sigma(it.value, it.sigma)} {it.unit}" for key, it in self.values.items()
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
            "parameters": {key: asdict(it) for key, it in self.values.items()},
            "where": self.where,
            "gap": {"before": self.gap_before, "after": self.gap_after},
            "replaced": list(self.replaced),
        }


@dataclass(frozen=True)
class _Attempt:
    """A class of so many summands, fitted; evidence: over the point it began from."""

    summands: tuple[Summand, ...]
    term: ModelTerm
    made: Refit
    evidence: float
    replaced: tuple[str, ...]


def scaffold(found: SearchResult, name: str, log: Path) -> Scaffold | None:
    """The effect `name` of what no listed effect explains in `log`; None where nothing is left."""
    state = found.final.state
    kept = [term for term in state.terms if not term.effect.name.startswith(PREFIX)]
    begin = refit_with_weights(state.afresh(kept))
    best: _Attempt | None = None
    for _ in range(_TERMS):
        further = _further(begin, best, name)
        if further is None:
            break
        best = further
    if best is None:
        return None
    made = refit_with_weights(best.made.state)
    before = made.point.at(_without(made.state, name))
    before = refit(before, rounds=2).point
    term = next(term for term in made.free if term.effect.name == name)
    values = fitted_values(term, made)
    words = where_words(before.residuals, made.point.residuals)
    usual = {key: abs(it.value) + (it.sigma or 0.0) for key, it in values.items()}
    places = {f"{key}=": it.value for key, it in values.items()}
    told = {key: f"{with_sigma(it.value, it.sigma)} {it.unit}" for key, it in values.items()}
    seen = SeenIn(log.absolute(), term.scope, words, told, {**usual, **places})
    return Scaffold(
        name,
        term.scope,
        source(name, best.summands, seen),
        words,
        values,
        gap(before.residuals),
        gap(made.point.residuals),
        best.replaced,
    )


def _without(state: State, name: str) -> State:
    return state.with_terms([term for term in state.terms if term.effect.name != name])


def _further(begin: Refit, best: _Attempt | None, name: str) -> _Attempt | None:
    """The best class of one summand more; None where none earns it."""
    point = (begin if best is None else best.made).point
    before = () if best is None else best.summands
    promising = _promising(point, None if best is None else best.term.scope)
    tried = []
    for one in promising:
        summands = (*before, Summand(one.shape, one.targets))
        kind = as_class(name, summands)
        start = kind() if best is None else kind(**best.term.effect.values())
        tried.append((summands, ModelTerm(start, one.scope)))
    if not tried:
        return None
    base = begin if best is None else best.made
    fits = [refit(base.point.at(_without(base.state, name).with_term(term))) for _, term in tried]
    tracked = [track_wheel_phase(it.state) for it in fits]
    walks = [base.point.weights.walks, *(own for _, own in tracked)]
    least = {node: min(own[node] for own in walks) for node in walks[0]}
    weights = replace(base.point.weights, walks=least)
    plain = refit(Point(base.state, weights), rounds=1)
    attempts = []
    for (summands, term), (state, _) in zip(tried, tracked, strict=True):
        made = fit_tracked(Point(state, weights), rounds=2)
        grown = len(term.effect.coordinates()) - (len(best.term.effect.coordinates()) if best else 0)
        evidence = gain_over(plain, made) / made.tempering - _cost(made, grown)
        attempts.append(_pruned(_Attempt(summands, term, made, evidence, ())))
    winner = max(attempts, key=lambda it: it.evidence)
    if winner.evidence < (_FIRST if best is None else _FURTHER):
        return None
    fitted = next(term for term in winner.made.free if term.key == winner.term.key)
    return replace(winner, term=fitted, replaced=((best.replaced if best else ()) + winner.replaced))


def _promising(point: Point, scope: str | None) -> list[Dependence]:
    """What is worth a fit: beside all that is in the model, and in the place of each name that was found.

    scope: the one that it must have.
    """
    named = [term for term in point.state.terms if term.moves and term.effect.name in BY_NAME]
    found = _diverse(scan(point), scope, _FITTED)
    for term in named[:_STANDING_IN]:
        less = [other for other in point.state.terms if other.key != term.key]
        without = refit(point.at(point.state.with_terms(less)), rounds=1).point
        found += _diverse(scan(without), scope, _INSTEAD)
    return _diverse(found, scope, len(found))


def _diverse(found: Sequence[Dependence], scope: str | None, most: int) -> list[Dependence]:
    """The best of each shape on each kind of target."""
    made: dict[tuple[str, ...], Dependence] = {}
    for one in found:
        key = (one.shape.weight, one.shape.words, one.scope, *(target.name for target in one.targets))
        if scope in (None, one.scope):
            made.setdefault(key, one)
    return list(made.values())[:most]


def _pruned(attempt: _Attempt) -> _Attempt:
    """Without the names that it does the work of: each costs more than it then brings."""
    made, evidence = attempt.made, attempt.evidence
    replaced: list[str] = []
    for term in [term for term in made.free if term.key != attempt.term.key]:
        less = made.state.with_terms([other for other in made.state.terms if other.key != term.key])
        without = fit_tracked(Point(track_wheel_phase(less)[0], made.point.weights), rounds=2)
        saved = _cost(made, _at_work(term, made)) - gain_over(without, made) / made.tempering
        if saved > 0.0:
            made, evidence = without, evidence + saved
            replaced.append(term.effect.name)
    return replace(attempt, made=made, evidence=evidence, replaced=tuple(replaced))


def _at_work(term: ModelTerm, made: Refit) -> int:
    """How many of a term's coordinates are clearly not zero; to count all would favour any other."""
    values = fitted_values(term, made).values()
    return max(1, sum(it.sigma is not None and abs(it.value) > _CLEAR * it.sigma for it in values))


def _cost(made: Refit, free: int) -> float:
    """Occam's factor of so many coordinates that all samples fix, as in BIC."""
    samples = sum(len(node.t) for node in made.point.problem.nodes)
    return 0.5 * free * log(samples / 4.0) + 3.0
