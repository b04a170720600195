"""Fast screening: what each candidate would gain if the model were linear, all from one linearisation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.gap.linear.directions import term_directions
from hubodo.gap.linear.linearised import Linearised, linearise, solved
from hubodo.gap.process_noise.point import Point
from hubodo.gap.screen.candidates import Candidate, all_directions, candidates
from hubodo.gap.screen.evidence import log_evidence
from hubodo.gap.screen.null_distribution import NullDistribution, ScoreTest, null_distribution


@dataclass(frozen=True)
class Screened:
    """What a candidate would bring, to first order.

    gain: of the log-likelihood. evidence: ln Bayes factor. value: (k,) of its coordinates, in scales.
    information: (k, k) about them where they begin, zero for what is not seen there.
    """

    candidate: Candidate
    gain: float
    evidence: float
    value: Array
    information: Array


@dataclass(frozen=True)
class Screening:
    """candidates: the best first. null: what the best of them would gain by chance. linear: of both."""

    candidates: list[Screened]
    null: NullDistribution
    linear: Linearised


def screen(point: Point) -> Screening:
    """Every candidate beside what the model has already."""
    free = [term for term in point.state.terms if term.moves]
    directions = all_directions(point.state)
    own, basis = term_directions(point.problem, free)
    linear = linearise(point, [*directions, *own])
    gram = linear.gram
    fitted = np.zeros((len(gram), basis.shape[1] + linear.nuisances))
    fitted[len(directions) : len(directions) + len(own), : basis.shape[1]] = basis
    fitted[linear.always, range(basis.shape[1], fitted.shape[1])] = 1.0
    beside = _beside(gram, fitted)
    scores = linear.blocks.times(beside[:, -1]) @ beside
    gram = beside.T @ gram @ beside
    fitted_keys = {term.key for term in free}
    made, tests = [], []
    for candidate in candidates(point.problem, directions):
        if candidate.term.key in fitted_keys:
            continue
        one, test = _judge(gram, linear.raw, candidate)
        made.append(one)
        tests.append(test)
    made.sort(key=lambda it: -it.evidence)
    return Screening(made, null_distribution(scores, tests), linear)


def _beside(gram: Array, fitted: Array) -> Array:
    """(D, D) each column less what moves along the columns of `fitted`, (D, f), do for it."""
    rows = fitted.T @ gram
    values, vectors = np.linalg.eigh(rows @ fitted)
    kept = values > 1e-6
    half = vectors[:, kept] / np.sqrt(values[kept])
    return np.asarray(np.eye(len(gram)) - fitted @ half @ (half.T @ rows))


def _judge(gram: Array, raw: Array, candidate: Candidate) -> tuple[Screened, ScoreTest]:
    """A candidate's gain, in the coordinates that the data see, and its test."""
    basis = candidate.basis
    count = len(basis)
    information = basis.T @ gram[:count, :count] @ basis
    covariance = solved(information, basis.T**2 @ raw[:count])
    b = basis.T @ gram[:count, -1]
    value = covariance @ b
    gain = 0.5 * float(b @ value)
    seen = np.diag(covariance) > 0.0
    information = information * np.outer(seen, seen)
    made = Screened(candidate, gain, log_evidence(gain, value, information), value, information)
    return made, ScoreTest(basis, covariance)
