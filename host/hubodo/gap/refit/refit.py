"""Gauss-Newton fit of the free terms of a model to all measurements, with tracked wheel angles."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hubodo.arrays import Array
from hubodo.gap.linear.directions import directions_of_terms, move_terms
from hubodo.gap.linear.linearisation import Linearisation, invert_information, linearise
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.process_noise.tracking import estimate_weights, track_wheel_phase
from hubodo.gap.process_noise.weights import weights_from_residuals
from hubodo.gap.refit.cross_validation import FoldDeviances, FoldGrams
from hubodo.gap.refit.jackknife import MAX_GROUPS, compute_jackknife_surprise
from hubodo.gap.refit.prior import (
    CoordinatePrior,
    adopt_prior,
    coordinate_slice,
    determine_prior,
    is_zero_in_guesses,
)
from hubodo.gap.refit.tempering import compute_tempering, measure_tempering
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
    full_covariance: covariance of coordinates and nuisances: given effects, then attitudes of bodies
    gram: gram matrix of coordinates, nuisances and, in the last row, the residual
    folds: folds of time, for held-out gains
    prior: Gaussian prior of the coordinates, from their usual sizes
    channel_shares: (K, C) squares of each coordinate's column in each channel, relative to its largest; None
        in a fit to two logs
    given_gain: gain of ln likelihood by differences of the given effects within their repeatability
    given_tempering: tempering of the coordinates and the given effects together
    min_tempering: its lower bound, of noise as uneven as that of the log
    groups: groups of blocks, for the jackknife; None in a fit to two logs
    """

    evaluation: Evaluation
    free_terms: tuple[ModelTerm, ...]
    covariance: Array
    robust_covariance: Array
    deviance: float
    block_scores: Array
    full_covariance: Array
    gram: Array
    folds: FoldGrams
    prior: CoordinatePrior
    channel_shares: Array | None = None
    given_gain: float = 0.0
    given_tempering: float = 1.0
    min_tempering: float = 1.0
    groups: FoldGrams | None = None

    @cached_property
    def fold_deviances(self) -> FoldDeviances:
        """Return the deviances of the folds, on first use: the iterations of a fit do not need them."""
        return self.folds.cross_validate(self.prior)

    @property
    def state(self) -> State:
        return self.evaluation.state

    @property
    def terms(self) -> list[ModelTerm]:
        """Return the terms whose coordinates the fit has, in order: the free ones, then the given effects."""
        return [*self.free_terms, *(term for term in self.state.terms if term.is_nuisance)]

    @property
    def step(self) -> Array:
        """Return the Gauss-Newton step of coordinates and nuisances, (K + nuisances,), in scales."""
        return np.asarray(self.full_covariance @ (self.gram[:-1, -1] - self.prior.gradient))

    @property
    def objective(self) -> float:
        """Return the deviance with the penalty of the prior, which a fit minimises."""
        return self.deviance + self.prior.penalty(self.step)

    @property
    def given_indices(self) -> slice:
        """Return the positions of the coordinates of given effects, which a fit leaves at their values."""
        n_attitudes = 3 * sum(not node.on_wheel for node in self.state.problem.nodes)
        return slice(len(self.covariance), len(self.full_covariance) - n_attitudes)

    @property
    def nuisance_information(self) -> Array:
        """Return the prior information about given effects, (K + nuisances,), infinite if frozen.

        It is zero for all others.
        """
        information = np.zeros(len(self.full_covariance))
        given = self.given_indices
        information[given] = np.where(self.prior.is_free, self.prior.information, np.inf)[given]
        return information

    def without_cache(self) -> Refit:
        """Return a copy without cached results; see `Evaluation.without_cache`."""
        return replace(self, evaluation=self.evaluation.without_cache())

    def coordinate_slice(self, term: ModelTerm) -> slice:
        """Return the positions of the coordinates of a free term. Raises KeyError for another term."""
        return coordinate_slice(self.free_terms, term)

    def information(self, term: ModelTerm) -> Array:
        """Return the information about a free term's coordinates, (k, k), with everything else fitted.

        It is zero for unobservable coordinates.
        """
        indices = np.arange(len(self.full_covariance))[self.coordinate_slice(term)]
        others = np.setdiff1d(np.arange(len(self.full_covariance)), indices)
        prior_information = self.nuisance_information
        is_fitted = (np.diag(self.full_covariance) > 0.0) & np.isfinite(prior_information)
        others = others[is_fitted[others]]
        cross = self.gram[np.ix_(indices, others)]
        rest_information = self.gram[np.ix_(others, others)] + np.diag(prior_information[others])
        information = (
            self.gram[np.ix_(indices, indices)]
            - cross @ np.linalg.pinv(rest_information, hermitian=True) @ cross.T
        )
        is_observed = np.diag(self.full_covariance)[indices] > 0.0
        return np.asarray(information * np.outer(is_observed, is_observed))

    def compute_surprise(self, term: ModelTerm, absent: Array) -> float:
        """Return -ln of the probability of a free term's estimate if it were at `absent`, (k,) coordinates.

        It is that of the jackknife; coordinates whose initial guess is not zero, such as a time constant, do
        not count.
        """
        assert self.groups is not None
        is_amplitude = is_zero_in_guesses(type(term.effect))
        value = (term.effect.coordinates() - absent) / term.effect.coordinate_scales()
        places = np.arange(len(self.full_covariance), dtype=np.intp)[self.coordinate_slice(term)]
        return compute_jackknife_surprise(self.groups, self.prior, value[is_amplitude], places[is_amplitude])

    @property
    def tempering(self) -> float:
        """Return the ratio of the scatter of the block scores to that of independent samples, at least 1.

        Few blocks scatter by chance; the excess that one in six such logs would show is deducted. Scores of
        given effects count as well: there are more of them than of one effect.
        """
        measured = compute_tempering(self.robust_covariance, self.covariance, len(self.block_scores))
        tempering = max(measured, self.min_tempering)
        given = self.given_indices
        return max(tempering, self.given_tempering) if given.stop > given.start else tempering


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
    fit = fit_tracked(Evaluation(tracked, estimate_weights(tracked)))
    for _ in range(_MAX_WEIGHT_UPDATES):
        tracked, walks = track_wheel_phase(fit.state)
        if all(walks[name] > 0.5 * walk for name, walk in fit.evaluation.weights.wheel_walks.items()):
            break
        fit = fit_tracked(Evaluation(tracked, weights_from_residuals(tracked, walks)))
    return fit


def linearise_fit(
    evaluation: Evaluation, linearisation: Linearisation | None = None, baseline: Refit | None = None
) -> Refit:
    """Linearise a fit at one evaluation, before any step.

    linearisation: linearisation along at least the terms of the fit, if already computed
    baseline: fit whose prior of the given effects is used, so that both fits leave the same ones free and
        their likelihoods are comparable; None to determine it from this fit

    Given effects are nuisances: the linear model lets them differ from the model file by their repeatability,
    as far as residuals are correlated, but the fit leaves them at their values.
    """
    free_terms = [term for term in evaluation.state.terms if term.is_refittable]
    terms = [*free_terms, *(term for term in evaluation.state.terms if term.is_nuisance)]
    directions, basis = directions_of_terms(evaluation.problem, terms, evaluation.state.terms)
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
    k = sum(len(term.effect.coordinates()) for term in free_terms)
    samples = evaluation.samples_per_block().sum(axis=1)
    given_tempering, min_tempering = measure_tempering(blocks, raw_squares, basis.shape[1], samples)
    if baseline is None:
        prior = determine_prior(terms, gram, raw_squares, given_tempering)
    else:
        is_same_fit = [term.key for term in free_terms] == [term.key for term in baseline.free_terms]
        tempering = baseline.prior.tempering if is_same_fit else given_tempering
        prior = adopt_prior(terms, len(gram) - 1, tempering, baseline.prior, baseline.terms)
    covariance = invert_information(gram[:-1, :-1], raw_squares, prior.information)
    step = covariance @ (gram[:-1, -1] - prior.gradient)
    score = blocks[:, :-1, -1] - blocks[:, :-1, :-1] @ step
    robust_covariance = covariance @ (score.T @ score) @ covariance
    deviance = _compute_deviance(gram, step)
    given_gain, is_given = 0.0, (np.arange(len(step)) >= k) & (np.arange(len(step)) < basis.shape[1])
    if is_given.any():
        as_given = prior.freeze(is_given)
        step_as_given = invert_information(gram[:-1, :-1], raw_squares, as_given.information) @ (
            gram[:-1, -1] - as_given.gradient
        )
        given_gain = 0.5 * (_compute_deviance(gram, step_as_given) - deviance)
    channel_squares = basis.T[:k] ** 2 @ linearised.channel_squares[: len(directions)]
    largest = np.maximum(channel_squares.max(axis=1, keepdims=True, initial=0.0), 1e-12)
    return Refit(
        evaluation,
        tuple(free_terms),
        covariance[:k, :k],
        robust_covariance[:k, :k],
        deviance + linearised.log_determinant,
        score[:, :k],
        covariance,
        gram,
        FoldGrams.of_blocks(blocks, raw_squares, samples),
        prior,
        channel_squares / largest,
        given_gain,
        given_tempering,
        min_tempering,
        FoldGrams.of_groups(blocks, raw_squares, samples, MAX_GROUPS),
    )


def _compute_deviance(gram: Array, step: Array) -> float:
    return float(gram[-1, -1] - 2.0 * step @ gram[:-1, -1] + step @ gram[:-1, :-1] @ step)


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
