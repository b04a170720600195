"""The search: round after round, the effect that earns its place is added, until none does."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace

import numpy as np

from hubodo.effects import EFFECTS
from hubodo.gap.linearised import settle, weights
from hubodo.gap.problem import NodeData, Problem
from hubodo.gap.refit import Refit, refit
from hubodo.gap.round import EMPIRICAL, Round, look
from hubodo.gap.screening import state_with
from hubodo.gap.size import gap, traces
from hubodo.gap.state import State
from hubodo.gap.terms import Term
from hubodo.gap.thinned import thinned
from hubodo.gap.wander import Weights
from hubodo.model.forward import Start

_MOST = 8
# What shows from one sample to the next needs every one.
_FROM_ALL = ("sample_repeat",)
_AGREED = 5
# A fit may leave the gap this much larger: what is missing still may fit ill beside it.
_NO_WORSE = 1.25

# Of the progress, what the search is.
_SHARE = 0.75

Say = Callable[[str, float], None]


@dataclass(frozen=True)
class Found:
    """The search's result. rounds: in order; each but the last added its best. thinned: whether the first
    of them saw only some of the samples."""

    rounds: tuple[Round, ...]
    final: Refit
    weights: Weights
    thinned: bool = False


def search(
    problem: Problem,
    state: State,
    accept: Collection[str] = (),
    reject: Collection[str] = (),
    say: Say = lambda words, share: None,
) -> Found:
    """Add effects until nothing earns its place.

    accept: names that are added first, in the scope that fits best, whatever else there is. reject: names
    that are not to be added. A log that is sampled faster than needed is searched with some of its samples
    first, and with all of them for what is left.
    """
    light = thinned(problem)
    if light is None:
        return _search(problem, state, accept, reject, say)
    first = _search(light, state, accept, {*reject, *_FROM_ALL}, say)
    rest = _search(problem, state.with_terms(first.final.state.terms), (), reject, say)
    return replace(rest, rounds=(*first.rounds[:-1], *rest.rounds), thinned=True)


def _search(
    problem: Problem, state: State, accept: Collection[str], reject: Collection[str], say: Say
) -> Found:
    current, weighed = fitted(problem, state)
    rounds: list[Round] = []
    wanted = [name for name in accept if name not in {term.effect.name for term in state.terms}]
    begun = sum(term.fitted for term in state.terms)
    for number in range(begun, _MOST + 1):
        say(f"round {number + 1}: every effect in every scope", _SHARE * number / (_MOST + 1))
        others = {effect.name for effect in EFFECTS if effect.name != wanted[0]} if wanted else set[str]()
        made = look(problem, current.state, weighed, {*reject, *others, *([EMPIRICAL] if wanted else [])})
        best = made.best
        if wanted and best is None and made.rivals:
            best = made.rivals[0]
        rounds.append(made)
        if wanted and best is None:
            wanted.pop(0)
            continue
        asked, wanted = bool(wanted), wanted[1:]
        if best is None or number == _MOST:
            break
        state = state_with(current.state if best.refit is None else best.refit.state, best.term)
        tried, fresh = fitted(problem, state)
        if best.term.moves and not asked and _grown(problem, current, tried, fresh):
            # The wheel was lost on the way: what needs that is no explanation.
            rounds.pop()
            reject = {*reject, best.term.effect.name}
            continue
        current, weighed = tried, fresh
    return Found(tuple(rounds), current, weighed)


def _grown(problem: Problem, before: Refit, after: Refit, weighed: Weights) -> bool:
    was, made = (gap(traces(problem, one.state, weighed)) for one in (before, after))
    return made > _NO_WORSE * was


def fitted(problem: Problem, state: State) -> tuple[Refit, Weights]:
    """A fit and weights that agree with it: what moves a wheel rightly leaves it less to wander."""
    weighed = reweigh(problem, settle(problem, state)[0])
    made = refit(problem, state, weighed)
    for _ in range(_AGREED):
        fresh = reweigh(problem, made.state)
        if all(fresh.walks[name] > 0.5 * walk for name, walk in weighed.walks.items()):
            break
        weighed = fresh
        made = refit(problem, made.state, weighed)
    return made, weighed


def reweigh(problem: Problem, state: State) -> Weights:
    """Weights from the state's own residual and its wheels' own walks."""
    state, walks = settle(problem, state)
    return weights(problem, state, walks)


def initial_state(problem: Problem) -> State:
    """The model file's own effects, given; nodes on the body turned so that gravity is where they feel it."""
    terms = []
    for item in problem.model.effects:
        level = item.effect.level
        terms.append(
            Term(item.effect, item.node or ("vehicle" if level == "vehicle" else "all"), fitted=False)
        )
    starts = {node.name: _attitude(node) for node in problem.nodes if not node.on_wheel}
    return State(tuple(terms), starts)


def _attitude(node: NodeData) -> Start:
    up = np.median(node.y[3:], axis=1)
    size = float(np.linalg.norm(up))
    if size < 1.0:
        return Start()
    z = up / size
    # The node reads R^T z: the smallest turn that does it.
    axis = np.cross(z, [0.0, 0.0, 1.0])
    sine = float(np.linalg.norm(axis))
    angle = float(np.arctan2(sine, z[2]))
    turn = axis / sine * angle if sine > 1e-9 else np.array([angle, 0.0, 0.0])
    return Start(attitude=(float(turn[0]), float(turn[1]), float(turn[2])))
