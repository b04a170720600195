"""A fit linearised at one evaluation: covariances, scores, folds and groups of its coordinates."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from hubodo.arrays import Array
from hubodo.gap.linear.directions import directions_of_terms
from hubodo.gap.linear.linearisation import Linearisation, invert_information, linearise
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.refit.cross_validation import FoldDeviances, FoldGrams
from hubodo.gap.refit.jackknife import MAX_GROUPS, JackknifeTest, apply_jackknife
from hubodo.gap.refit.prior import (
    CoordinatePrior,
    adopt_prior,
    coordinate_slice,
    determine_prior,
    is_zero_in_guesses,
)
from hubodo.gap.refit.tempering import compute_tempering, measure_tempering
from hubodo.gap.state.state import State
from hubodo.gap.state.terms import ModelTerm


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

    def apply_jackknife(self, term: ModelTerm, absent: Array) -> JackknifeTest:
        """Test a free term's estimate by the jackknife against `absent`, (k,) coordinates.

        Coordinates whose initial guess is not zero, such as a time constant, do not count.
        """
        assert self.groups is not None
        is_amplitude = is_zero_in_guesses(type(term.effect))
        value = (term.effect.coordinates() - absent) / term.effect.coordinate_scales()
        places = np.arange(len(self.full_covariance), dtype=np.intp)[self.coordinate_slice(term)]
        return apply_jackknife(self.groups, self.prior, value[is_amplitude], places[is_amplitude])

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
    transform = block_diag(basis, np.eye(linearised.n_nuisances + 1))
    blocks = np.einsum("dk,bde,ef->bkf", transform, linearised.block_grams.unpack(), transform, optimize=True)
    gram, raw_squares = blocks.sum(axis=0), (transform.T**2 @ linearised.raw_squares)[:-1]
    k = sum(len(term.effect.coordinates()) for term in free_terms)
    samples = evaluation.samples_per_block().sum(axis=1)
    given_tempering, min_tempering = measure_tempering(
        blocks, raw_squares, basis.shape[1], samples, evaluation.weights.is_correlated
    )
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
