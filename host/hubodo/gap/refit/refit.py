"""Gauss-Newton fit of the free terms of a model to all measurements, with tracked wheel angles."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from hubodo.arrays import Array
from hubodo.gap.linear.directions import directions_of_terms, move_terms
from hubodo.gap.linear.linearisation import Linearisation, invert_information, linearise
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.process_noise.tracking import estimate_weights, track_wheel_phase
from hubodo.gap.process_noise.weights import weights_from_residuals
from hubodo.gap.refit.cross_validation import FoldDeviances, cross_validate
from hubodo.gap.refit.prior import CoordinatePrior, build_prior
from hubodo.gap.state.state import ATTITUDE_SCALE, State
from hubodo.gap.state.terms import ModelTerm
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
# P-value (1 sigma, one-sided) above which excess scatter of the block scores is attributed to chance.
_CHANCE_SCATTER_P_VALUE = 0.16
# Iterations after which a fit above its maximum deviance is abandoned.
_MIN_ITERATIONS = 2
# Iterations for weights and fit to become consistent.
_MAX_WEIGHT_UPDATES = 5


@dataclass(frozen=True)
class Refit:
    """Result of a fit; K: coordinates of the free terms, in scales.

    evaluation: evaluation at the end of the fit
    free_terms: the terms that were fitted
    covariance: (K, K), for independent samples
    robust_covariance: (K, K), from the scatter of the block scores
    deviance: -2 ln likelihood, up to a constant common to all refits with the same weights
    block_scores: (B, K), score of each block
    full_covariance: covariance of coordinates and nuisances
    gram: gram matrix of coordinates, nuisances and, in the last row, the residual
    fold_deviances: deviances of folds of time, for held-out gains
    prior: Gaussian prior of the coordinates, from their usual sizes
    channel_shares: (K, C) squares of each coordinate's column in each channel, relative to its largest; None
        in a fit to two logs
    """

    evaluation: Evaluation
    free_terms: tuple[ModelTerm, ...]
    covariance: Array
    robust_covariance: Array
    deviance: float
    block_scores: Array
    full_covariance: Array
    gram: Array
    fold_deviances: FoldDeviances
    prior: CoordinatePrior
    channel_shares: Array | None = None

    @property
    def state(self) -> State:
        return self.evaluation.state

    @property
    def step(self) -> Array:
        """Return the Gauss-Newton step of coordinates and nuisances, (K + nuisances,), in scales."""
        return np.asarray(self.full_covariance @ (self.gram[:-1, -1] - self.prior.gradient))

    @property
    def objective(self) -> float:
        """Return the deviance with the penalty of the prior, which a fit minimises."""
        return self.deviance + self.prior.penalty(self.step)

    def without_cache(self) -> Refit:
        """Return a copy without cached results; see `Evaluation.without_cache`."""
        return replace(self, evaluation=self.evaluation.without_cache())

    def coordinate_slice(self, term: ModelTerm) -> slice:
        """Return the positions of the coordinates of a free term. Raises KeyError for another term."""
        first = 0
        for other in self.free_terms:
            size = len(other.effect.coordinates())
            if other.key == term.key:
                return slice(first, first + size)
            first += size
        raise KeyError(term.key)

    def information(self, term: ModelTerm) -> Array:
        """Return the information about a free term's coordinates, (k, k), with everything else fitted.

        It is zero for unobservable coordinates.
        """
        indices = np.arange(len(self.full_covariance))[self.coordinate_slice(term)]
        others = np.setdiff1d(np.arange(len(self.full_covariance)), indices)
        others = others[np.diag(self.full_covariance)[others] > 0.0]
        cross = self.gram[np.ix_(indices, others)]
        rest_information = self.gram[np.ix_(others, others)]
        information = (
            self.gram[np.ix_(indices, indices)]
            - cross @ np.linalg.pinv(rest_information, hermitian=True) @ cross.T
        )
        is_observed = np.diag(self.full_covariance)[indices] > 0.0
        return np.asarray(information * np.outer(is_observed, is_observed))

    @property
    def tempering(self) -> float:
        """Return the ratio of the scatter of the block scores to that of independent samples, at least 1.

        Few blocks scatter by chance; the excess that one in six such logs would show is deducted.
        """
        return _compute_tempering(self.block_scores, self.covariance)


def _compute_tempering(block_scores: Array, covariance: Array) -> float:
    n_observed = int(np.count_nonzero(np.diag(covariance)))
    if not n_observed:
        return 1.0
    ratio = np.trace(block_scores.T @ block_scores @ covariance) / n_observed
    degrees_of_freedom = n_observed * max(len(block_scores) - 1.0, 1.0)
    return max(1.0, float(ratio * degrees_of_freedom / chdtri(degrees_of_freedom, _CHANCE_SCATTER_P_VALUE)))


def compute_gain(before: Refit, after: Refit) -> float:
    """Return the gain of ln likelihood from one fit to another with the same weights."""
    return 0.5 * (before.deviance - after.deviance)


def compute_model_gain(fit: Refit) -> float:
    """Return the gain of ln likelihood of all effects of a fit, with the same weights."""
    if not fit.state.terms:
        return 0.0
    without = fit.evaluation.with_state(fit.state.reset_with_terms(()))
    return compute_gain(refit(without, rounds=0), fit)


def refit(evaluation: Evaluation, rounds: int = _MAX_ITERATIONS) -> Refit:
    """Fit all terms with `is_fitted`, starting with newly tracked wheels; the weights are not changed."""
    return fit_tracked(evaluation.with_state(track_wheel_phase(evaluation.state)[0]), rounds)


def fit_tracked(evaluation: Evaluation, rounds: int = _MAX_ITERATIONS) -> Refit:
    """Fit like `refit`, from a state with tracked wheels; `rounds` of 1 accepts only the full step."""
    return continue_fit(linearise_fit(evaluation), rounds)


def continue_fit(start: Refit, rounds: int = _MAX_ITERATIONS, max_deviance: float = math.inf) -> Refit:
    """Iterate a fit; one whose deviance stays above `max_deviance` ends after two iterations."""
    step_size = _step_sigmas(start)
    for iteration in range(rounds):
        tempering = start.tempering
        tolerance = _DEVIANCE_TOLERANCE * tempering
        if step_size**2 < _CONVERGED_SIGMAS**2 * tempering or (
            iteration >= _MIN_ITERATIONS and start.deviance > max_deviance
        ):
            break
        # The deviance already includes the step; if it grows, the step left the linear range.
        for fraction in _STEP_FRACTIONS if rounds > 1 else _STEP_FRACTIONS[:1]:
            state, _walks = track_wheel_phase(_apply_step(start, fraction * start.step))
            attempt = linearise_fit(start.evaluation.with_state(state), tempering=start.prior.tempering)
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
    """Return the length of the remaining step in sigma."""
    step = fit.step
    return float(np.sqrt(step @ np.linalg.pinv(fit.full_covariance) @ step)) if len(step) else 0.0


def refit_with_weights(state: State) -> Refit:
    """Fit and re-estimate the weights until both are consistent.

    An effect that explains a wheel's rotation reduces the random walk that the wheel needs.
    """
    tracked, _walks = track_wheel_phase(state)
    fit = fit_tracked(Evaluation(tracked, estimate_weights(tracked)))
    for _ in range(_MAX_WEIGHT_UPDATES):
        tracked, walks = track_wheel_phase(fit.state)
        if all(walks[name] > 0.5 * walk for name, walk in fit.evaluation.weights.wheel_walks.items()):
            break
        fit = fit_tracked(Evaluation(tracked, weights_from_residuals(tracked, walks)))
    return fit


def linearise_fit(
    evaluation: Evaluation, linearisation: Linearisation | None = None, tempering: float | None = None
) -> Refit:
    """Linearise a fit at one evaluation, before any step.

    linearisation: linearisation along at least the terms of the fit, if already computed
    tempering: tempering of the prior; None to use that of this fit
    """
    free_terms = [term for term in evaluation.state.terms if term.is_refittable]
    directions, basis = directions_of_terms(evaluation.problem, free_terms, evaluation.state.terms)
    linearised = (
        linearise(evaluation, directions)
        if linearisation is None
        else linearisation.select_directions(directions)
    )
    transform = np.zeros(
        (len(directions) + linearised.n_nuisances + 1, basis.shape[1] + linearised.n_nuisances + 1)
    )
    transform[: len(directions), : basis.shape[1]] = basis
    n_tail = linearised.n_nuisances + 1
    transform[-n_tail:, -n_tail:] = np.eye(n_tail)
    blocks = np.einsum("dk,bde,ef->bkf", transform, linearised.block_grams.unpack(), transform, optimize=True)
    gram, raw_squares = blocks.sum(axis=0), (transform.T**2 @ linearised.raw_squares)[:-1]
    covariance, k = invert_information(gram[:-1, :-1], raw_squares), basis.shape[1]
    score = blocks[:, :-1, -1] - blocks[:, :-1, :-1] @ (covariance @ gram[:-1, -1])
    if tempering is None:
        tempering = _compute_tempering(score[:, :k], covariance[:k, :k])
    prior = build_prior(free_terms, len(gram) - 1, tempering)
    covariance = invert_information(gram[:-1, :-1], raw_squares, prior.information)
    step = covariance @ (gram[:-1, -1] - prior.gradient)
    score = blocks[:, :-1, -1] - blocks[:, :-1, :-1] @ step
    robust_covariance = covariance @ (score.T @ score) @ covariance
    deviance = (
        float(gram[-1, -1] - 2.0 * step @ gram[:-1, -1] + step @ gram[:-1, :-1] @ step)
        + linearised.log_determinant
    )
    channel_squares = basis.T**2 @ linearised.channel_squares[: len(directions)]
    largest = np.maximum(channel_squares.max(axis=1, keepdims=True, initial=0.0), 1e-12)
    return Refit(
        evaluation,
        tuple(free_terms),
        covariance[:k, :k],
        robust_covariance[:k, :k],
        deviance,
        score[:, :k],
        covariance,
        gram,
        cross_validate(blocks, raw_squares, prior, evaluation.samples_per_block().sum(axis=1)),
        prior,
        channel_squares / largest,
    )


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
    for node, rotation in zip(bodies, step[count:].reshape(-1, 3), strict=True):
        attitude = np.array(fit.state.start_of(node).attitude) + np.clip(rotation, -4.0, 4.0) * ATTITUDE_SCALE
        starts[node.name] = NodeInitialState(
            attitude=(float(attitude[0]), float(attitude[1]), float(attitude[2]))
        )
    return replace(fit.state, terms=terms, starts=starts)
