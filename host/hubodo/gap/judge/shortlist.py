"""Choice of the screened candidates that a round refits."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

from hubodo.gap.process_noise.weights import declared_wheel_walk
from hubodo.gap.refit.linear_fit import Refit
from hubodo.gap.screen.screening import ScreenedCandidate, screen_candidates

# Chosen, and judged together with the other settings of the search, by `make gap-matrix`.
# Candidates to refit, the first of them of different effects; the duration of a round is proportional to it.
_MAX_REFITS, _MIN_REFITTED_EFFECTS = 6, 4
# Ratio of a wheel's walk to the declared one, from which on its angle counts as lost; additional candidates
# to refit in that case.
_LOST_WHEEL_RATIO, _MAX_STRICT_REFITS = 3.0, 3


def select_for_refit(
    screened: list[ScreenedCandidate],
    always_refit: Collection[tuple[str, str]],
    strictly_screened: list[ScreenedCandidate],
) -> list[ScreenedCandidate]:
    """Return the best of the screening, the requested ones, and those that explain how a lost wheel turns."""
    selected = _shortlist(screened, _MAX_REFITS)
    requested = [next(item for item in screened if item.candidate.term.key == key) for key in always_refit]
    for item in [*requested, *strictly_screened]:
        if item.candidate.term.key not in [other.candidate.term.key for other in selected]:
            selected.append(item)
    return selected


def _shortlist(screened: list[ScreenedCandidate], count: int) -> list[ScreenedCandidate]:
    """Return the best few candidates with positive evidence, with the best seed of each effect and scope.

    The best scopes of several effects come first, because a nonlinear effect gains more than its score
    promises; then other scopes of the first effect.
    """
    best: dict[tuple[str, str], ScreenedCandidate] = {}
    for item in screened:
        if item.evidence >= 0.0:
            best.setdefault(item.candidate.term.key, item)
    first_scopes: dict[str, ScreenedCandidate] = {}
    for item in best.values():
        first_scopes.setdefault(item.candidate.name, item)
    leading = list(first_scopes.values())[:_MIN_REFITTED_EFFECTS]
    others = [item for item in best.values() if item not in leading]
    # Which clock or gyro of two is wrong is decided by refits of both.
    others.sort(key=lambda item: item.candidate.name != leading[0].candidate.name)
    return [*leading, *others][:count]


def screen_strictly(before: Refit, reject: Collection[str]) -> list[ScreenedCandidate]:
    """Screen with the declared walks if a wheel is lost.

    A large walk absorbs a wrong wheel rotation, so that its cause would gain nothing.
    """
    problem, weights = before.evaluation.problem, before.evaluation.weights
    declared_walks = {
        node.name: declared_wheel_walk(problem, node) for node in problem.nodes if node.on_wheel
    }
    if all(weights.wheel_walks[name] <= _LOST_WHEEL_RATIO * walk for name, walk in declared_walks.items()):
        return []
    screened = screen_candidates(
        replace(before.evaluation, weights=replace(weights, wheel_walks=declared_walks)),
        before.nuisance_information,
    ).candidates
    return _shortlist([item for item in screened if item.candidate.name not in reject], _MAX_STRICT_REFITS)
