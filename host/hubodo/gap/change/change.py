"""Changes between two logs of one vehicle: effects, their size, and the p-value of no change."""

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
from hubodo.gap.state.terms import ALL, VEHICLE, ModelTerm, model_of_terms, scope_of
from hubodo.gap.workflow import find_gap
from hubodo.model.model_file import Model, ScopedEffect
from hubodo.recording import Recording

# P-value below which a change is reported.
CHANGE_P_VALUE = 0.01


@dataclass(frozen=True)
class Change:
    """An effect with another value in the second log.

    values: by parameter, before, after and their difference
    p_value: how often the best candidate differs as much by chance
    where: channels, times and regimes that show it, in words
    """

    effect: str
    scope: str
    values: dict[str, tuple[Estimate, Estimate, Estimate]]
    p_value: float
    where: str

    def as_json(self) -> dict[str, Any]:
        """Return the entry of `changes` in `change.json`."""
        keys = ("before", "after", "change")
        return {
            "effect": self.effect,
            "scope": self.scope,
            "parameters": {
                name: {
                    key: {"value": estimate.value, "sigma": estimate.sigma}
                    for key, estimate in zip(keys, three, strict=True)
                }
                | {"unit": three[0].unit}
                for name, three in self.values.items()
            },
            "p_value": self.p_value,
            "where": self.where,
        }


@dataclass(frozen=True)
class ChangeResult:
    """Result of comparing two logs.

    p_value: how often two logs differ as much if nothing has changed
    changes: in order of discovery
    unnamed_terms: needed by the second log only
    model_before, model_after: the vehicle in the first and in the second log
    """

    p_value: float
    changes: tuple[Change, ...]
    unnamed_terms: tuple[str, ...]
    model_before: Model
    model_after: Model
    warnings: tuple[str, ...]

    @property
    def has_changed(self) -> bool:
        """Return True if the logs differ significantly."""
        return self.p_value < CHANGE_P_VALUE

    def as_json(self) -> dict[str, Any]:
        """Return the content of `change.json`."""
        return {
            "changed": self.has_changed,
            "p_value": self.p_value,
            "changes": [change.as_json() for change in self.changes],
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
    """Find what differs in the second log from the first.

    Raises InputError if a log does not belong to the model, or the logs have different nodes.
    """
    problems = [build_problem(log, model, name) for log, name in zip((before, after), log_names, strict=True)]
    names = [{node.name for node in problem.nodes} for problem in problems]
    if names[0] != names[1]:
        raise InputError(
            f"{log_names[0]} has {', '.join(names[0])}, {log_names[1]} has {', '.join(names[1])}: "
            "compare logs with the same nodes"
        )
    result_before = find_gap(
        before,
        model,
        log_name=log_names[0],
        report_progress=lambda words, share: report_progress(words, 0.45 * share),
    )
    model_before = _drop_unnamed(result_before.model)
    result_after = find_gap(
        after,
        model_before,
        log_name=log_names[1],
        report_progress=lambda words, share: report_progress(words, 0.45 + 0.45 * share),
    )
    report_progress("comparing", 0.92)
    found_before = [item for item in model_before.effects if item not in model.effects]
    p_value = compare_logs(*_with_common_values(problems, found_before)).p_value
    found_after = [item for item in result_after.found if not item.effect.startswith(PREFIX)]
    unnamed = tuple(item.effect for item in result_after.found if item.effect.startswith(PREFIX))
    free_terms = [*found_before, *(_scoped_effect(item, result_after.model) for item in found_after)]
    fits = [_fit_log(problem, free_terms) for problem in problems]
    null_distribution = compare_logs(fits[0].evaluation, fits[1].evaluation).null_distribution
    all_changes = (
        [_build_change(item, fits, null_distribution) for item in found_after]
        if p_value < CHANGE_P_VALUE
        else []
    )
    changes = tuple(item for item in all_changes if item.p_value < CHANGE_P_VALUE)
    models = [model_of_terms(model, fit.state.terms) for fit in fits]
    warnings = tuple(dict.fromkeys([*result_before.warnings, *result_after.warnings]))
    return ChangeResult(
        p_value, changes, unnamed if p_value < CHANGE_P_VALUE else (), models[0], models[1], warnings
    )


def _drop_unnamed(model: Model) -> Model:
    """Return the model without unnamed terms."""
    return replace(
        model, effects=tuple(item for item in model.effects if not item.effect.name.startswith(PREFIX))
    )


def _scoped_effect(finding: Finding, model: Model) -> ScopedEffect:
    node = None if finding.scope in (ALL, VEHICLE) else finding.scope
    return next(item for item in model.effects if (item.effect.name, item.node) == (finding.effect, node))


def _free_terms(items: Sequence[ScopedEffect]) -> list[ModelTerm]:
    """Return free terms; of two for the same effect and scope the last."""
    terms = {}
    for item in items:
        term = ModelTerm(item.effect, scope_of(item))
        terms[term.key] = term
    return list(terms.values())


def _fit_log(problem: Problem, items: Sequence[ScopedEffect]) -> Refit:
    """Fit a log with these effects free, beside those of the model file."""
    terms = _free_terms(items)
    initial_state = build_initial_state(problem)
    keys = {term.key for term in terms}
    return refit_with_weights(
        initial_state.with_terms([*(term for term in initial_state.terms if term.key not in keys), *terms])
    )


def _with_common_values(
    problems: Sequence[Problem], items: Sequence[ScopedEffect]
) -> tuple[Evaluation, Evaluation]:
    """Return evaluations of both logs with common values, each under its own weights."""
    fits = [_fit_log(problem, items) for problem in problems]
    common = {term.key: _average_term(term, fits) for term in fits[0].free_terms}
    states = [fit.state.with_terms([common.get(term.key, term) for term in fit.state.terms]) for fit in fits]
    return fits[0].evaluation.with_state(states[0]), fits[1].evaluation.with_state(states[1])


def _average_term(term: ModelTerm, fits: Sequence[Refit]) -> ModelTerm:
    """Return a term with each coordinate averaged over both fits by inverse variance."""
    coordinates, weights = [], []
    for fit in fits:
        own = next(free_term for free_term in fit.free_terms if free_term.key == term.key)
        variance = np.diag(_larger_covariance(fit, fit.coordinate_slice(own)))
        coordinates.append(own.effect.coordinates())
        weights.append(np.where(variance > 0.0, 1.0 / np.where(variance > 0.0, variance, 1.0), 1e-12))
    return term.with_coordinates(np.average(coordinates, axis=0, weights=weights))


def _build_change(finding: Finding, fits: Sequence[Refit], null_distribution: NullDistribution) -> Change:
    """Build the change of an effect that the second log requires beside the first one's model."""
    key = (finding.effect, finding.scope)
    terms = [next(term for term in fit.free_terms if term.key == key) for fit in fits]
    values = [estimate_parameters(term, fit) for term, fit in zip(terms, fits, strict=True)]
    slices = [fit.coordinate_slice(term) for term, fit in zip(terms, fits, strict=True)]
    covariance = sum(_larger_covariance(fit, place) for fit, place in zip(fits, slices, strict=True))
    difference = (terms[1].effect.coordinates() - terms[0].effect.coordinates()) / terms[
        0
    ].effect.coordinate_scales()
    is_observed = np.diag(np.asarray(covariance)) > 0.0
    observed_covariance = np.asarray(covariance)[np.ix_(is_observed, is_observed)]
    gain = 0.5 * float(
        difference[is_observed]
        @ np.linalg.pinv(observed_covariance, hermitian=True)
        @ difference[is_observed]
    )
    values_by_name = {}
    for name, before in values[0].items():
        after = values[1][name]
        sigma = (
            None
            if before.sigma is None or after.sigma is None
            else float(np.hypot(before.sigma, after.sigma))
        )
        values_by_name[name] = (before, after, Estimate(after.value - before.value, sigma, before.unit))
    return Change(
        finding.effect,
        finding.scope,
        values_by_name,
        null_distribution.p_value(gain, int(is_observed.sum())),
        finding.where,
    )


def _larger_covariance(fit: Refit, place: slice) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the larger covariance, (k, k) in scales: for independent samples or from block scores."""
    robust, plain = fit.robust_covariance[place, place], fit.covariance[place, place]
    return robust if np.trace(robust) > np.trace(plain) else plain
