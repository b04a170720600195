"""What has changed on a vehicle between two logs: names, by how much, and the chance that nothing has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hubodo.effects.empirical import PREFIX
from hubodo.errors import InputError
from hubodo.gap.change.score_test import compare_logs
from hubodo.gap.explain.finding import estimate_parameters
from hubodo.gap.explain.result import Estimate, Finding
from hubodo.gap.judge.round import ReportProgress
from hubodo.gap.judge.search import build_initial_state
from hubodo.gap.problem.build import build_problem
from hubodo.gap.problem.problem import Problem
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.refit.refit import Refit, refit_with_weights
from hubodo.gap.screen.null_distribution import NullDistribution
from hubodo.gap.state.terms import ALL, VEHICLE, ModelTerm
from hubodo.gap.workflow import find_gap
from hubodo.model.model_file import Model, ScopedEffect
from hubodo.recording import Recording

# A change is named when chance makes one as large in less than one of a hundred pairs of logs.
CHANGE_P_VALUE = 0.01


@dataclass(frozen=True)
class Change:
    """An effect that is another in the second log. values: by parameter, before, after and by how much.

    p_value: how often the best of all candidates differs as much by chance.
    """

    effect: str
    scope: str
    values: dict[str, tuple[Estimate, Estimate, Estimate]]
    p_value: float
    where: str

    def as_json(self) -> dict[str, Any]:
        keys = ("before", "after", "change")
        return {
            "effect": self.effect,
            "scope": self.scope,
            "parameters": {
                name: {
                    key: {"value": it.value, "sigma": it.sigma} for key, it in zip(keys, three, strict=True)
                }
                | {"unit": three[0].unit}
                for name, three in self.values.items()
            },
            "p_value": self.p_value,
            "where": self.where,
        }


@dataclass(frozen=True)
class ChangeResult:
    """p_value: how often two logs differ as much as these where nothing has changed.

    changes: in order of discovery. unnamed: terms without a name that the second log alone asks for. before,
    after: the vehicle as it was, and as it is.
    """

    p_value: float
    changes: tuple[Change, ...]
    unnamed_terms: tuple[str, ...]
    model_before: Model
    model_after: Model
    warnings: tuple[str, ...]

    @property
    def has_changed(self) -> bool:
        return self.p_value < CHANGE_P_VALUE

    def as_json(self) -> dict[str, Any]:
        """What `change.json` holds."""
        return {
            "changed": self.has_changed,
            "p_value": self.p_value,
            "changes": [it.as_json() for it in self.changes],
            "unnamed": list(self.unnamed_terms),
            "warnings": list(self.warnings),
        }


def find_change(
    before: Recording,
    after: Recording,
    model: Model,
    *,
    log_names: tuple[str, str] = ("before", "after"),
    report_progress: ReportProgress = lambda words, share: None,
) -> ChangeResult:
    """What is another in the second log than in the first.

    Raises InputError when a log does not belong to the model, or the two have not the same nodes.
    """
    problems = [build_problem(log, model, name) for log, name in zip((before, after), log_names, strict=True)]
    names = [{node.name for node in problem.nodes} for problem in problems]
    if names[0] != names[1]:
        raise InputError(
            f"{log_names[0]} has {', '.join(names[0])}, {log_names[1]} has {', '.join(names[1])}: "
            "compare logs with the same nodes"
        )
    first = find_gap(
        before,
        model,
        log_name=log_names[0],
        report_progress=lambda words, share: report_progress(words, 0.45 * share),
    )
    was = _drop_unnamed(first.model)
    second = find_gap(
        after,
        was,
        log_name=log_names[1],
        report_progress=lambda words, share: report_progress(words, 0.45 + 0.45 * share),
    )
    report_progress("comparing", 0.92)
    found = [item for item in was.effects if item not in model.effects]
    p_value = compare_logs(*_with_common_values(problems, found)).p_value
    own = [it for it in second.found if not it.effect.startswith(PREFIX)]
    unnamed = tuple(it.effect for it in second.found if it.effect.startswith(PREFIX))
    free = [*found, *(_scoped_effect(it, second.model) for it in own)]
    fits = [_fit_log(problem, free) for problem in problems]
    null = compare_logs(fits[0].evaluation, fits[1].evaluation).null_distribution
    made = [_build_change(it, fits, null) for it in own] if p_value < CHANGE_P_VALUE else []
    changes = tuple(it for it in made if it.p_value < CHANGE_P_VALUE)
    models = [_build_model(model, fit) for fit in fits]
    warnings = tuple(dict.fromkeys([*first.warnings, *second.warnings]))
    return ChangeResult(
        p_value, changes, unnamed if p_value < CHANGE_P_VALUE else (), models[0], models[1], warnings
    )


def _drop_unnamed(model: Model) -> Model:
    """Without terms that have no name."""
    return replace(model, effects=tuple(it for it in model.effects if not it.effect.name.startswith(PREFIX)))


def _scoped_effect(found: Finding, model: Model) -> ScopedEffect:
    node = None if found.scope in (ALL, VEHICLE) else found.scope
    return next(it for it in model.effects if (it.effect.name, it.node) == (found.effect, node))


def _free_terms(free: Sequence[ScopedEffect]) -> list[ModelTerm]:
    """Free terms; of two for one place the last."""
    made = {}
    for item in free:
        level = item.effect.level
        scope = item.node or (VEHICLE if level == "vehicle" else ALL)
        made[item.effect.name, scope] = ModelTerm(item.effect, scope)
    return list(made.values())


def _fit_log(problem: Problem, free: Sequence[ScopedEffect]) -> Refit:
    """A log with these free, beside what the model file has."""
    terms = _free_terms(free)
    begin = build_initial_state(problem)
    keys = {term.key for term in terms}
    return refit_with_weights(begin.with_terms([*(it for it in begin.terms if it.key not in keys), *terms]))


def _with_common_values(
    problems: Sequence[Problem], found: Sequence[ScopedEffect]
) -> tuple[Evaluation, Evaluation]:
    """Both logs with the same values, the mean of both fits, each weighed as when it is fitted itself."""
    fits = [_fit_log(problem, found) for problem in problems]
    same = {term.key: _average_term(term, fits) for term in fits[0].free_terms}
    states = [fit.state.with_terms([same.get(term.key, term) for term in fit.state.terms]) for fit in fits]
    return fits[0].evaluation.with_state(states[0]), fits[1].evaluation.with_state(states[1])


def _average_term(term: ModelTerm, fits: Sequence[Refit]) -> ModelTerm:
    """A term with each coordinate where both fits together have it."""
    there, weights = [], []
    for fit in fits:
        own = next(it for it in fit.free_terms if it.key == term.key)
        variance = np.diag(_larger_covariance(fit, fit.coordinate_slice(own)))
        there.append(own.effect.coordinates())
        weights.append(np.where(variance > 0.0, 1.0 / np.where(variance > 0.0, variance, 1.0), 1e-12))
    return term.with_coordinates(np.average(there, axis=0, weights=weights))


def _build_change(found: Finding, fits: Sequence[Refit], null: NullDistribution) -> Change:
    """A name that the second log asks for beside the first one's model."""
    key = (found.effect, found.scope)
    terms = [next(term for term in fit.free_terms if term.key == key) for fit in fits]
    values = [estimate_parameters(term, fit) for term, fit in zip(terms, fits, strict=True)]
    places = [fit.coordinate_slice(term) for term, fit in zip(terms, fits, strict=True)]
    covariance = sum(_larger_covariance(fit, place) for fit, place in zip(fits, places, strict=True))
    apart = (terms[1].effect.coordinates() - terms[0].effect.coordinates()) / terms[
        0
    ].effect.coordinate_scales()
    seen = np.diag(np.asarray(covariance)) > 0.0
    inner = np.asarray(covariance)[np.ix_(seen, seen)]
    gain = 0.5 * float(apart[seen] @ np.linalg.pinv(inner, hermitian=True) @ apart[seen])
    three = {}
    for name, old in values[0].items():
        new = values[1][name]
        sigma = None if old.sigma is None or new.sigma is None else float(np.hypot(old.sigma, new.sigma))
        three[name] = (old, new, Estimate(new.value - old.value, sigma, old.unit))
    return Change(found.effect, found.scope, three, null.p_value(gain, int(seen.sum())), found.where)


def _larger_covariance(fit: Refit, place: slice) -> np.ndarray[Any, np.dtype[np.float64]]:
    """(k, k) in scales: the larger of what independent samples and the scatter of blocks say."""
    robust, plain = fit.robust_covariance[place, place], fit.covariance[place, place]
    return robust if np.trace(robust) > np.trace(plain) else plain


def _build_model(model: Model, fit: Refit) -> Model:
    scoped = [
        ScopedEffect(term.effect, None if term.scope in (ALL, VEHICLE) else term.scope)
        for term in fit.state.terms
    ]
    return replace(model, effects=()).with_effects(*scoped)
