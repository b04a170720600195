"""Score tests of all candidates from one linearisation (Rao 1948)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.gap.linear.directions import directions_of_terms
from hubodo.gap.linear.linearisation import Linearisation, invert_information, linearise
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.screen.candidates import Candidate, list_candidates, list_directions
from hubodo.gap.screen.evidence import compute_log_evidence
from hubodo.gap.screen.null_distribution import NullDistribution, ScoreTest, draw_null_distribution


@dataclass(frozen=True)
class ScreenedCandidate:
    """A candidate with its first-order result.

    gain: gain of the log-likelihood
    evidence: ln Bayes factor
    coordinates: (k,), fitted, in scales
    information: (k, k) about them at their starting values, zero for unobservable ones
    """

    candidate: Candidate
    gain: float
    evidence: float
    coordinates: Array
    information: Array


@dataclass(frozen=True)
class Screening:
    """Results of a screening.

    candidates: the best first
    null_distribution: null distribution of the largest gain
    linearisation: linearised model along all candidates
    """

    candidates: list[ScreenedCandidate]
    null_distribution: NullDistribution
    linearisation: Linearisation


def screen_candidates(evaluation: Evaluation, prior_information: Array | None = None) -> Screening:
    """Screen every candidate in addition to the terms of the current model.

    prior_information: about the coordinates of the fit of that model, followed by its nuisances; infinite
        for a given effect that is frozen. None if no effect is given
    """
    terms = evaluation.state.terms
    free_terms = [term for term in terms if term.is_refittable]
    nuisances = [term for term in terms if term.is_nuisance and prior_information is not None]
    directions = list_directions(evaluation.state)
    term_directions, basis = directions_of_terms(evaluation.problem, [*free_terms, *nuisances], terms)
    linearisation = linearise(evaluation, [*directions, *term_directions])
    gram = linearisation.gram
    fitted_basis = np.zeros((len(gram), basis.shape[1] + linearisation.n_nuisances))
    fitted_basis[len(directions) : len(directions) + len(term_directions), : basis.shape[1]] = basis
    fitted_basis[linearisation.nuisance_indices, range(basis.shape[1], fitted_basis.shape[1])] = 1.0
    information = np.zeros(fitted_basis.shape[1]) if prior_information is None else prior_information
    is_free = np.isfinite(information)
    coefficients = _regress(gram, fitted_basis[:, is_free], information[is_free])
    projection = np.eye(len(gram)) - fitted_basis[:, is_free] @ coefficients
    scores = linearisation.block_grams.multiply(projection[:, -1]) @ projection
    gram = projection.T @ gram @ projection + coefficients.T @ (information[is_free, None] * coefficients)
    fitted_keys = {term.key for term in free_terms}
    screened, tests = [], []
    for candidate in list_candidates(evaluation.problem, directions):
        if candidate.term.key in fitted_keys:
            continue
        result, test = _score_candidate(gram, linearisation.raw_squares, candidate)
        screened.append(result)
        tests.append(test)
    screened.sort(key=lambda candidate_result: -candidate_result.evidence)
    return Screening(screened, draw_null_distribution(scores, tests), linearisation)


def _regress(gram: Array, fitted_basis: Array, prior_information: Array) -> Array:
    """Return the coefficients, (f, D), of each column's regression on the fitted columns, (D, f)."""
    rows = fitted_basis.T @ gram
    values, vectors = np.linalg.eigh(rows @ fitted_basis + np.diag(prior_information))
    is_observed = values > 1e-6
    whitened = vectors[:, is_observed] / np.sqrt(values[is_observed])
    return np.asarray(whitened @ (whitened.T @ rows))


def _score_candidate(
    gram: Array, raw_squares: Array, candidate: Candidate
) -> tuple[ScreenedCandidate, ScoreTest]:
    """Return a candidate's gain in its observable coordinates, and its score test."""
    basis = candidate.basis
    count = len(basis)
    information = basis.T @ gram[:count, :count] @ basis
    covariance = invert_information(information, basis.T**2 @ raw_squares[:count])
    b = basis.T @ gram[:count, -1]
    value = covariance @ b
    gain = 0.5 * float(b @ value)
    is_observed = np.diag(covariance) > 0.0
    information = information * np.outer(is_observed, is_observed)
    result = ScreenedCandidate(
        candidate, gain, compute_log_evidence(gain, value, information), value, information
    )
    return result, ScoreTest(basis, covariance)
