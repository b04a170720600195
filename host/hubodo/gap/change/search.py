"""Search for changes between two logs, one change after the other."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

from hubodo.effects import BY_NAME
from hubodo.gap.change.difference import (
    ChangeCandidate,
    LogPair,
    add_term,
    fit_separate,
    list_differences,
    rejudge_change,
    separate_keys,
)
from hubodo.gap.change.joint import EffectKey
from hubodo.gap.change.scatter import list_scatter_differences
from hubodo.gap.judge.hypothesis import Hypothesis
from hubodo.gap.judge.posterior import compute_posterior
from hubodo.gap.judge.round import MIN_ADD_PROBABILITY
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.process_noise.tracking import estimate_weights, track_wheel_phase
from hubodo.gap.state.state import State
from hubodo.gap.state.terms import ALL, ModelTerm

# Largest number of changes, which bounds the duration.
_MAX_CHANGES = 6
# Iterations of the fits of the separate terms at the start of a round, and of a remounted sensor.
_START_ITERATIONS, _REMOUNTED_ITERATIONS = 3, 8
# Scatter of the block scores with the best single change in the model, relative to independent noise, from
# which on several effects have changed at once. Roads reach 15.
_MIN_SEVERAL_TEMPERING = 50.0
# Fraction of the gain of a remounted sensor below which another change may be an error of modelling it.
_MIN_SHARE_BESIDE_REMOUNT = 1e-3
# Effects that change together when a sensor is remounted.
_MOUNTING_EFFECTS = ("node_misalignment", "lever_arm")


@dataclass(frozen=True)
class PairSearchResult:
    """Result of the search for changes between two logs.

    first: both logs with common values, except for effects that belong to one drive
    last: both logs with all changes
    changes: the largest gain first
    """

    first: LogPair
    last: LogPair
    changes: tuple[Hypothesis, ...]


def search_changes(
    states: tuple[State, State],
    separate: Collection[EffectKey],
    tempering: float,
    report_progress: Callable[[str, float], None],
) -> PairSearchResult:
    """Search the changes from the first log to the second.

    states: states of both logs, with the same model
    separate: keys of the terms that belong to each drive
    """
    first = pair = _start(states, separate, tempering)
    changes: dict[EffectKey, Hypothesis] = {}
    min_gain = 0.0
    while len(changes) < _MAX_CHANGES:
        report_progress(f"round {len(changes) + 1}", len(changes) / _MAX_CHANGES)
        best = _find_best(pair, changes, min_gain)
        if best is None:
            break
        several = None if changes else _remount_nodes(pair, best)
        if several is not None:
            min_gain = _MIN_SHARE_BESIDE_REMOUNT * 0.5 * (_deviance(pair) - _deviance(several))
            pair = _start(_states_of(several), several.separate, tempering)
            changes = {key: _judge_key(pair, key) for key in pair.separate - first.separate}
            continue
        changes = {key: one for key, one in changes.items() if not _is_replaced(key, best.key)}
        changes[best.key] = best.hypothesis
        pair = _start(_states_of(best.pair), best.pair.separate, tempering)
    if len(changes) > 1:
        pair, changes = _drop_redundant(pair, changes)
    ordered = sorted(changes.values(), key=lambda one: -one.gain)
    return PairSearchResult(first, pair, tuple(ordered))


def _states_of(pair: LogPair) -> tuple[State, State]:
    return pair.fits[0].state, pair.fits[1].state


def _start(states: Sequence[State], separate: Collection[EffectKey], tempering: float) -> LogPair:
    """Fit the separate terms of each log under its own weights, with wheel walks common to both logs."""
    tracked = [track_wheel_phase(state)[0] for state in states]
    weights = [estimate_weights(state) for state in tracked]
    walks = {node: min(one.wheel_walks[node] for one in weights) for node in weights[0].wheel_walks}
    evaluations = [
        Evaluation(state, replace(one, wheel_walks=walks))
        for state, one in zip(tracked, weights, strict=True)
    ]
    return fit_separate(evaluations, separate, tempering, _START_ITERATIONS)


def _deviance(pair: LogPair) -> float:
    return sum(fit.deviance for fit in pair.fits)


def _find_best(pair: LogPair, excluded: Collection[EffectKey], min_gain: float) -> ChangeCandidate | None:
    """Return the most probable change that gains enough; None if no change is probable enough."""
    differences = [*list_differences(pair), *list_scatter_differences(pair)]
    candidates = {
        one.key: one for one in differences if one.key not in excluded and one.hypothesis.gain >= min_gain
    }
    ordered, nothing = compute_posterior([one.hypothesis for one in candidates.values()])
    if not ordered or nothing > 1.0 - MIN_ADD_PROBABILITY:
        return None
    return replace(candidates[ordered[0].key], hypothesis=ordered[0])


def _is_replaced(key: EffectKey, by: EffectKey) -> bool:
    """Return True if a change of the same effect in another scope replaces this one."""
    return key[0] == by[0] and ALL in (key[1], by[1])


def _remount_nodes(pair: LogPair, best: ChangeCandidate) -> LogPair | None:
    """Return both logs with remounted nodes, if that explains more than the best change."""
    if max(fit.tempering for fit in best.pair.fits) < _MIN_SEVERAL_TEMPERING:
        return None
    states, separate = _states_of(pair), pair.separate
    for node in pair.evaluations[0].problem.nodes:
        for name in _MOUNTING_EFFECTS:
            states = (_with_own(states[0], name, node.name), _with_own(states[1], name, node.name))
            separate = separate_keys(separate, states[0], (name, node.name))
    evaluations = [one.with_state(state) for one, state in zip(pair.evaluations, states, strict=True)]
    several = fit_separate(evaluations, separate, pair.tempering, _REMOUNTED_ITERATIONS)
    return several if _deviance(several) < _deviance(best.pair) else None


def _with_own(state: State, name: str, node: str) -> State:
    """Return a state in which a node has a term of its own for an effect."""
    terms = {term.scope: term for term in state.terms if term.effect.name == name}
    if node in terms:
        return state
    effect = terms[ALL].effect if ALL in terms else BY_NAME[name]()
    return add_term(state, ModelTerm(effect, node))


def _judge_key(pair: LogPair, key: EffectKey) -> Hypothesis:
    return rejudge_change(pair, key, max(fit.tempering for fit in pair.fits))


def _drop_redundant(
    pair: LogPair, changes: dict[EffectKey, Hypothesis]
) -> tuple[LogPair, dict[EffectKey, Hypothesis]]:
    """Drop changes that gain nothing once the others are in the model, the weakest first."""
    in_scatter = {key: one for key, one in changes.items() if one.proposal is not None}
    keys = [key for key in changes if key not in in_scatter]
    while keys:
        judged = {key: _judge_key(pair, key) for key in keys}
        weakest = min(keys, key=lambda key: judged[key].evidence)
        if judged[weakest].evidence > 0.0:
            return pair, {**judged, **in_scatter}
        keys.remove(weakest)
        before, after = _states_of(pair)
        common = next(term for term in before.terms if term.key == weakest)
        after = after.with_terms([common if term.key == weakest else term for term in after.terms])
        pair = _start((before, after), pair.separate - {weakest}, pair.tempering)
    return pair, in_scatter
