"""The search: rounds that add effects until none is significant."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from hubodo.effects import BY_NAME
from hubodo.gap.judge.journal import Journal
from hubodo.gap.judge.round import EMPIRICAL, ReportProgress, Round
from hubodo.gap.problem.problem import NodeData, Problem
from hubodo.gap.process_noise.residual import compute_gap
from hubodo.gap.refit.linear_fit import Refit
from hubodo.gap.refit.refit import refit_with_weights
from hubodo.gap.state.state import State
from hubodo.gap.state.terms import terms_of_model
from hubodo.model.forward import NodeInitialState

# Largest number of effects, one per round, which bounds the duration.
_MAX_EFFECTS = 10
# Largest number of effects added provisionally, while other missing effects hide their gain.
_MAX_PROVISIONAL = 3
# Effects between consecutive samples are not visible after decimation.
_NEEDS_EVERY_SAMPLE = ("sample_repeat",)
# Largest growth of the gap by adding an effect, as other missing effects may interfere.
_MAX_GAP_GROWTH = 1.25

# Ratio of a wheel's random walk with its trend to the walk without it, above which the cause of the trend is
# searched.
_MIN_TREND_RATIO = 2.0

# Fraction of the reported progress for the search.
_SEARCH_PROGRESS_SHARE = 0.75


@dataclass(frozen=True)
class SearchResult:
    """All rounds of a search.

    rounds: in order; each but the last added its best or provisional hypothesis
    final: fit of all effects added
    used_decimation: True if the first rounds used decimated samples
    """

    rounds: tuple[Round, ...]
    final: Refit
    used_decimation: bool = False


@dataclass(frozen=True)
class SearchObserver:
    """Journal and callbacks of a running search.

    journal: stores the rounds of the search
    report_progress: called with the activity as text and the completed fraction of the search
    on_effect_added: called with the intermediate result after each effect
    """

    journal: Journal = field(default_factory=Journal)
    report_progress: ReportProgress = lambda words, share: None
    on_effect_added: Callable[[SearchResult], None] = lambda result: None


def search_effects(
    state: State,
    accept: Collection[str] = (),
    reject: Collection[str] = (),
    observer: SearchObserver | None = None,
) -> SearchResult:
    """Add effects until none is significant.

    accept: effects that are added first, in their best scope, without a test
    reject: effects not considered

    A log with a higher rate than needed is searched with decimated samples first, then with all samples.
    """
    observer = observer or SearchObserver()
    decimated = state.problem.decimate()
    if decimated is None:
        return _search_rounds(state, accept, reject, observer)
    first = _search_rounds(
        replace(state, problem=decimated), accept, {*reject, *_NEEDS_EVERY_SAMPLE}, observer
    )
    second = _search_rounds(
        state.with_terms(first.final.state.terms), (), reject, observer, first.rounds[:-1]
    )
    return replace(second, used_decimation=True)


def _search_rounds(
    state: State,
    accept: Collection[str],
    reject: Collection[str],
    observer: SearchObserver,
    earlier_rounds: tuple[Round, ...] = (),
) -> SearchResult:
    """Search from a state to which `earlier_rounds` led."""
    fit = refit_with_weights(replace(state)).without_cache()
    rounds: list[Round] = []
    pending_accepted = [name for name in accept if name not in {term.effect.name for term in state.terms}]
    n_initial, n_provisional = sum(term.is_fitted for term in state.terms), 0
    for number in range(n_initial, _MAX_EFFECTS + 1):
        others = {name for name in BY_NAME if name != pending_accepted[0]} if pending_accepted else set[str]()
        judged = observer.journal.judge_round(
            fit.evaluation,
            {*reject, *others, *([EMPIRICAL] if pending_accepted else [])},
            report_progress=partial(_report_round, observer.report_progress, number),
        )
        best = judged.best
        if pending_accepted and best is None and judged.hypotheses:
            best = judged.hypotheses[0]
        rounds.append(judged)
        if pending_accepted and best is None:
            pending_accepted.pop(0)
            continue
        was_accepted, pending_accepted = bool(pending_accepted), pending_accepted[1:]
        if best is None and n_provisional < _MAX_PROVISIONAL:
            # Its gain becomes visible once later effects are in the model; otherwise it is removed again.
            best, n_provisional = judged.provisional, n_provisional + 1
        if best is None and number < _MAX_EFFECTS:
            steady = _with_steady_wheels(fit)
            if steady is not None:
                fit = steady
                continue
        if best is None or number == _MAX_EFFECTS:
            break
        state = (best.state or fit.state).with_term(best.term)
        attempt = refit_with_weights(replace(state)).without_cache()
        if best.term.is_refittable and not was_accepted and is_worse(fit, attempt):
            # The fit lost track of the wheel, so the effect is no explanation.
            rounds.pop()
            reject = {*reject, best.term.effect.name}
            continue
        fit = attempt
        if judged.best is None and not was_accepted:
            continue
        observer.on_effect_added(SearchResult((*earlier_rounds, *rounds), fit))
    return SearchResult((*earlier_rounds, *rounds), fit)


def _with_steady_wheels(fit: Refit) -> Refit | None:
    """Return the fit with trends of wheel phases separated from their walks; None if there are no trends.

    While a wheel's phase drifts steadily because of a wrong scale or bias, its walk is so large that neither
    the cause of the drift nor the wheel that has a small error can be identified.
    """
    if fit.state.has_steady_wheels:
        return None
    steady = refit_with_weights(replace(fit.state, has_steady_wheels=True)).without_cache()
    walks, steady_walks = fit.evaluation.weights.wheel_walks, steady.evaluation.weights.wheel_walks
    is_smaller = any(walk > _MIN_TREND_RATIO * steady_walks[name] for name, walk in walks.items())
    return steady if is_smaller else None


def _report_round(report_progress: ReportProgress, number: int, words: str, share: float) -> None:
    report_progress(
        f"round {number + 1}: {words}", _SEARCH_PROGRESS_SHARE * (number + share) / (_MAX_EFFECTS + 1)
    )


def is_worse(before: Refit, after: Refit) -> bool:
    """Return True if the gap grew from one fit to another: the effect interferes with others."""
    gap_before = compute_gap(
        replace(before.without_cache().evaluation, weights=after.evaluation.weights).residuals
    )
    return compute_gap(after.without_cache().evaluation.residuals) > _MAX_GAP_GROWTH * gap_before


def build_initial_state(problem: Problem) -> State:
    """Return the state of the model file's own effects, with nodes on the body aligned to gravity."""
    starts = {node.name: _initial_attitude(node) for node in problem.nodes if not node.on_wheel}
    return State(problem, terms_of_model(problem.model), starts)


def _initial_attitude(node: NodeData) -> NodeInitialState:
    """Return the smallest rotation that aligns the median specific force of a node with the vertical."""
    up = np.median(node.y[3:], axis=1)
    norm = float(np.linalg.norm(up))
    if norm < 1.0:
        return NodeInitialState()
    z = up / norm
    # The node measures Rᵀ z for an upward specific force z.
    axis = np.cross(z, [0.0, 0.0, 1.0])
    sine = float(np.linalg.norm(axis))
    angle = float(np.arctan2(sine, z[2]))
    rotation = axis / sine * angle if sine > 1e-9 else np.array([angle, 0.0, 0.0])
    return NodeInitialState(attitude=(float(rotation[0]), float(rotation[1]), float(rotation[2])))
