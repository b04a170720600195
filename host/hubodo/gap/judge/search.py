"""The search: round after round, the effect that earns its place is added, until none does."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from hubodo.effects import BY_NAME
from hubodo.gap.judge.journal import Journal
from hubodo.gap.judge.round import EMPIRICAL, Round, Say
from hubodo.gap.problem.problem import NodeData, Problem
from hubodo.gap.process_noise.residual import gap
from hubodo.gap.refit.refit import Refit, refit_with_weights
from hubodo.gap.state.state import State
from hubodo.gap.state.terms import ModelTerm
from hubodo.model.forward import NodeInitialState

# Effects that are added at most, a round each: a bound on the time.
_MOST = 8
# Effects that are added on trial, as something else that is missing hides what they are worth.
_HOPES = 3
# What shows from one sample to the next needs every one.
_FROM_ALL = ("sample_repeat",)
# A fit may leave the gap this much larger: what is missing still may fit ill beside it.
_NO_WORSE = 1.25

# Of the progress, what the search is.
_SHARE = 0.75


@dataclass(frozen=True)
class SearchResult:
    """All rounds of a search.

    rounds: in order; each but the last added its best, or what it had hope for. final: the fit of all that
    was added. decimated: whether the first rounds saw only some of the samples.
    """

    rounds: tuple[Round, ...]
    final: Refit
    decimated: bool = False


@dataclass(frozen=True)
class Watch:
    """What is told of a search while it goes on.

    journal: its rounds. say: what is tried, and the share of it all that is done. reached: what is found so
    far, after each effect.
    """

    journal: Journal = field(default_factory=Journal)
    say: Say = lambda words, share: None
    reached: Callable[[SearchResult], None] = lambda found: None


def search(
    state: State,
    accept: Collection[str] = (),
    reject: Collection[str] = (),
    watch: Watch | None = None,
) -> SearchResult:
    """Add effects until nothing earns its place.

    accept: names that are added first, in the scope that fits best, whatever else there is. reject: names
    that are not to be added. A log that is sampled faster than needed is searched with some of its samples
    first, and with all of them for what is left.
    """
    watch = watch or Watch()
    light = state.problem.decimated()
    if light is None:
        return _search(state, accept, reject, watch)
    first = _search(replace(state, problem=light), accept, {*reject, *_FROM_ALL}, watch)
    second = _search(state.with_terms(first.final.state.terms), (), reject, watch, first.rounds[:-1])
    return replace(second, decimated=True)


def _search(
    state: State,
    accept: Collection[str],
    reject: Collection[str],
    watch: Watch,
    behind: tuple[Round, ...] = (),
) -> SearchResult:
    """behind: rounds that came before, of which the state has what they added."""
    current = refit_with_weights(replace(state)).bare()
    rounds: list[Round] = []
    wanted = [name for name in accept if name not in {term.effect.name for term in state.terms}]
    begun, hoped = sum(term.fitted for term in state.terms), 0
    for number in range(begun, _MOST + 1):
        others = {name for name in BY_NAME if name != wanted[0]} if wanted else set[str]()
        made = watch.journal.look(
            current.point,
            {*reject, *others, *([EMPIRICAL] if wanted else [])},
            say=partial(_in_round, watch.say, number),
        )
        best = made.best
        if wanted and best is None and made.rivals:
            best = made.rivals[0]
        rounds.append(made)
        if wanted and best is None:
            wanted.pop(0)
            continue
        asked, wanted = bool(wanted), wanted[1:]
        if best is None and hoped < _HOPES:
            # What it is worth is seen beside all that comes after it, or it leaves again.
            best, hoped = made.hopeful, hoped + 1
        if best is None or number == _MOST:
            break
        state = (best.state or current.state).with_term(best.term)
        tried = refit_with_weights(replace(state)).bare()
        if best.term.moves and not asked and _grown(current, tried):
            # The wheel was lost on the way: what needs that is no explanation.
            rounds.pop()
            reject = {*reject, best.term.effect.name}
            continue
        current = tried
        if made.best is None and not asked:
            continue
        watch.reached(SearchResult((*behind, *rounds), current))
    return SearchResult((*behind, *rounds), current)


def _in_round(say: Say, number: int, words: str, share: float) -> None:
    say(f"round {number + 1}: {words}", _SHARE * (number + share) / (_MOST + 1))


def _grown(before: Refit, after: Refit) -> bool:
    was = gap(replace(before.bare().point, weights=after.point.weights).residuals)
    return gap(after.bare().point.residuals) > _NO_WORSE * was


def initial_state(problem: Problem) -> State:
    """The model file's own effects, given; nodes on the body turned so that gravity is where they feel it."""
    terms = []
    for item in problem.model.effects:
        level = item.effect.level
        terms.append(
            ModelTerm(item.effect, item.node or ("vehicle" if level == "vehicle" else "all"), fitted=False)
        )
    starts = {node.name: _attitude(node) for node in problem.nodes if not node.on_wheel}
    return State(problem, tuple(terms), starts)


def _attitude(node: NodeData) -> NodeInitialState:
    up = np.median(node.y[3:], axis=1)
    size = float(np.linalg.norm(up))
    if size < 1.0:
        return NodeInitialState()
    z = up / size
    # The node reads R^T z: the smallest turn that does it.
    axis = np.cross(z, [0.0, 0.0, 1.0])
    sine = float(np.linalg.norm(axis))
    angle = float(np.arctan2(sine, z[2]))
    turn = axis / sine * angle if sine > 1e-9 else np.array([angle, 0.0, 0.0])
    return NodeInitialState(attitude=(float(turn[0]), float(turn[1]), float(turn[2])))
