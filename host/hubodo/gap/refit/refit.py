"""Gauss-Newton fit of the free terms of a model to all measurements, with tracked wheel angles."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from hubodo.arrays import Array
from hubodo.gap.linear.directions import move_terms
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.process_noise.noise_correlation import correlate_noise
from hubodo.gap.process_noise.tracking import estimate_weights, track_wheel_phase
from hubodo.gap.process_noise.weights import weights_from_residuals
from hubodo.gap.refit.linear_fit import Refit, linearise_fit
from hubodo.gap.state.state import ATTITUDE_SCALE, State
from hubodo.model.forward import NodeInitialState

_MAX_ITERATIONS = 6
# Largest step of a coordinate in scales; the model is not linear beyond that.
MAX_STEP_SCALES = 8.0
# Step in sigma and increase of the deviance below which a fit has converged, both relative to the scatter of
# the block scores: a log that no model fits is not fitted to the last nat.
_CONVERGED_SIGMAS, _DEVIANCE_TOLERANCE = 0.2, 3.0
# Fractions of a step to try; share of the promised gain from which on one is accepted.
_STEP_FRACTIONS = (1.0, 0.3, 0.1)
_MIN_PROMISED_SHARE = 0.5
# A fit has stalled if an iteration gains no likelihood and leaves more than this share of the step.
_STALLED_STEP_RATIO = 0.7
# Iterations after which a fit above its maximum deviance is abandoned.
_MIN_ITERATIONS = 2
# Iterations for weights and fit to become consistent.
_MAX_WEIGHT_UPDATES = 5


def compute_gain(before: Refit, after: Refit) -> float:
    """Return the gain of ln likelihood from one fit to another with the same weights."""
    return 0.5 * (before.deviance - after.deviance)


def compute_model_gain(fit: Refit) -> float:
    """Return the gain of ln likelihood of all effects of a fit, with the same weights."""
    return _compute_gain_over(fit, fit.state.reset_with_terms(())) if fit.state.terms else 0.0


def compute_added_gain(fit: Refit) -> float:
    """Return the gain of ln likelihood of all effects that the model file lacks, with the same weights."""
    added = [term.key for term in fit.state.terms if term.is_fitted]
    return _compute_gain_over(fit, fit.state.without_terms(added)) if added else 0.0


def _compute_gain_over(fit: Refit, state: State) -> float:
    return compute_gain(refit(fit.evaluation.with_state(state), rounds=0), fit)


def refit(evaluation: Evaluation, rounds: int = _MAX_ITERATIONS, baseline: Refit | None = None) -> Refit:
    """Fit all terms with `is_fitted`, starting with newly tracked wheels; the weights are not changed.

    baseline: as in `linearise_fit`
    """
    return fit_tracked(evaluation.with_state(track_wheel_phase(evaluation.state)[0]), rounds, baseline)


def fit_tracked(
    evaluation: Evaluation, rounds: int = _MAX_ITERATIONS, baseline: Refit | None = None
) -> Refit:
    """Fit like `refit`, from a state with tracked wheels; `rounds` of 1 accepts only the full step."""
    return continue_fit(linearise_fit(evaluation, baseline=baseline), rounds)


def continue_fit(start: Refit, rounds: int = _MAX_ITERATIONS, max_deviance: float = math.inf) -> Refit:
    """Iterate a fit; one whose deviance stays above `max_deviance` ends after two iterations."""
    step_size = _step_sigmas(start)
    for iteration in range(rounds):
        tempering = max(start.tempering, start.prior.tempering)
        tolerance = _DEVIANCE_TOLERANCE * tempering
        if step_size**2 < _CONVERGED_SIGMAS**2 * tempering or (
            iteration >= _MIN_ITERATIONS and start.deviance > max_deviance
        ):
            break
        # The deviance already includes the step; if it grows, the step left the linear range.
        for fraction in _STEP_FRACTIONS if rounds > 1 else _STEP_FRACTIONS[:1]:
            state, _walks = track_wheel_phase(_apply_step(start, fraction * start.step))
            attempt = linearise_fit(start.evaluation.with_state(state), baseline=start)
            if attempt.objective < start.objective + tolerance + _MIN_PROMISED_SHARE * step_size**2:
                break
        else:
            break
        previous_objective, previous_size = start.objective, step_size
        start, step_size = attempt, _step_sigmas(attempt)
        is_better = start.objective < previous_objective - tolerance
        if not is_better and step_size > _STALLED_STEP_RATIO * previous_size:
            break
    return start


def _step_sigmas(fit: Refit) -> float:
    """Return the length of the remaining step in sigma, of what a fit moves."""
    is_fitted = np.ones(len(fit.full_covariance), bool)
    is_fitted[fit.given_indices] = False
    step, covariance = fit.step[is_fitted], fit.full_covariance[np.ix_(is_fitted, is_fitted)]
    return float(np.sqrt(step @ np.linalg.pinv(covariance) @ step)) if len(step) else 0.0


def refit_with_weights(state: State) -> Refit:
    """Fit and re-estimate the weights until both are consistent.

    An effect that explains a wheel's rotation reduces the random walk that the wheel needs.
    """
    tracked, _walks = track_wheel_phase(state)
    fit = fit_tracked(_with_correlation(Evaluation(tracked, estimate_weights(tracked))))
    for _ in range(_MAX_WEIGHT_UPDATES):
        tracked, walks = track_wheel_phase(fit.state)
        if all(walks[name] > 0.5 * walk for name, walk in fit.evaluation.weights.wheel_walks.items()):
            break
        fit = fit_tracked(_with_correlation(Evaluation(tracked, weights_from_residuals(tracked, walks))))
    return fit


def _with_correlation(evaluation: Evaluation) -> Evaluation:
    """Return an evaluation under weights with the correlation of the noise, if its state asks for that."""
    return correlate_noise(evaluation) if evaluation.state.has_correlated_noise else evaluation


def _apply_step(fit: Refit, step: Array) -> State:
    count = len(fit.covariance)
    coordinate_step = step[:count] * min(
        1.0, MAX_STEP_SCALES / max(float(np.abs(step[:count]).max(initial=0.0)), 1e-9)
    )
    steps = [coordinate_step[fit.coordinate_slice(term)] for term in fit.free_terms]
    refitted = iter(move_terms(fit.free_terms, steps))
    terms = tuple(next(refitted) if term.is_refittable else term for term in fit.state.terms)
    starts = dict(fit.state.starts)
    bodies = [node for node in fit.state.problem.nodes if not node.on_wheel]
    for node, rotation in zip(bodies, step[fit.given_indices.stop :].reshape(-1, 3), strict=True):
        attitude = np.array(fit.state.start_of(node).attitude) + np.clip(rotation, -4.0, 4.0) * ATTITUDE_SCALE
        starts[node.name] = NodeInitialState(
            attitude=(float(attitude[0]), float(attitude[1]), float(attitude[2]))
        )
    return replace(fit.state, terms=terms, starts=starts)
