"""Gram matrices of two logs, with coordinates that are common to both and coordinates of each log."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.gap.linear.directions import directions_of_terms
from hubodo.gap.linear.linearisation import invert_information, linearise
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.refit.cross_validation import FoldDeviances, FoldGrams
from hubodo.gap.refit.prior import CoordinatePrior, build_prior
from hubodo.gap.refit.refit import MAX_STEP_SCALES
from hubodo.gap.screen.candidates import Candidate, list_candidates, list_directions
from hubodo.gap.state.terms import ModelTerm

Indices = NDArray[np.intp]
EffectKey = tuple[str, str]
"""Name of an effect, and its scope."""

# Variance, in scales, below which a coordinate is frozen rather than estimated.
FROZEN_VARIANCE = 1e-14


@dataclass(frozen=True)
class LogGrams:
    """One log, linearised along D directions of the candidates, and along its free terms and nuisances.

    blocks: (B, D + K + 1, D + K + 1) gram matrix of each block of time; the last row is the residual
    raw_squares: (D + K,) as in `Linearisation`
    """

    evaluation: Evaluation
    terms: tuple[ModelTerm, ...]
    candidates: tuple[Candidate, ...]
    n_directions: int
    blocks: Array
    raw_squares: Array
    log_determinant: float


def linearise_log(evaluation: Evaluation, with_candidates: bool) -> LogGrams:
    """Linearise a log along its free terms and, if requested, along every candidate."""
    terms = tuple(term for term in evaluation.state.terms if term.is_refittable)
    directions = list_directions(evaluation.state) if with_candidates else []
    term_directions, basis = directions_of_terms(evaluation.problem, terms, evaluation.state.terms)
    linearised = linearise(evaluation, [*directions, *term_directions])
    n_directions, n_tail = len(directions), linearised.n_nuisances + 1
    size = n_directions + len(term_directions) + n_tail
    transform = np.zeros((size, n_directions + basis.shape[1] + n_tail))
    transform[:n_directions, :n_directions] = np.eye(n_directions)
    transform[n_directions : size - n_tail, n_directions:-n_tail] = basis
    transform[-n_tail:, -n_tail:] = np.eye(n_tail)
    blocks = transform.T @ linearised.block_grams.unpack() @ transform
    candidates = list_candidates(evaluation.problem, directions) if directions else []
    raw_squares = (transform.T**2 @ linearised.raw_squares)[:-1]
    return LogGrams(
        evaluation, terms, tuple(candidates), n_directions, blocks, raw_squares, linearised.log_determinant
    )


@dataclass(frozen=True)
class JointFit:
    """A linear fit of both logs along P coordinates.

    blocks: (B, P + 1, P + 1), the last row is the residual
    raw_squares: (P,)
    samples: (B,) readings in each block
    log_determinant: ln det of the innovation covariances of both logs
    """

    blocks: Array
    raw_squares: Array
    prior: CoordinatePrior
    samples: Array
    log_determinant: float

    @cached_property
    def gram(self) -> Array:
        return np.asarray(self.blocks.sum(axis=0))

    @cached_property
    def covariance(self) -> Array:
        """Return the covariance for independent samples, (P, P); zero for unobservable coordinates."""
        return invert_information(self.gram[:-1, :-1], self.raw_squares, self.prior.information)

    @cached_property
    def step(self) -> Array:
        """Return the step to the optimum, (P,) in scales."""
        return np.asarray(self.covariance @ (self.gram[:-1, -1] - self.prior.gradient))

    @cached_property
    def robust_covariance(self) -> Array:
        """Return the covariance from the scatter of the block scores, (P, P)."""
        scores = self.block_scores
        return np.asarray(self.covariance @ (scores.T @ scores) @ self.covariance)

    @cached_property
    def block_scores(self) -> Array:
        return np.asarray(self.blocks[:, :-1, -1] - self.blocks[:, :-1, :-1] @ self.step)

    @cached_property
    def deviance(self) -> float:
        """Return -2 ln likelihood, up to a constant."""
        step, gram = self.step, self.gram
        quadratic = gram[-1, -1] - 2.0 * step @ gram[:-1, -1] + step @ gram[:-1, :-1] @ step
        return float(quadratic) + self.log_determinant

    @property
    def objective(self) -> float:
        """Return the deviance with the penalty of the prior, which a fit minimises."""
        return self.deviance + self.prior.penalty(self.step)

    @property
    def folds(self) -> FoldGrams:
        """Return the folds of time of both logs, for held-out gains."""
        return FoldGrams.of_blocks(self.blocks, self.raw_squares, self.samples)

    @cached_property
    def fold_deviances(self) -> FoldDeviances:
        """Return the deviances of the folds."""
        return self.folds.cross_validate(self.prior)


@dataclass(frozen=True)
class JointGrams:
    """Both logs along the D directions of the candidates and P joint coordinates.

    logs: before and after
    indices: for each log, indices of its own coordinates among the joint ones
    blocks: (B, D + P + 1, D + P + 1), blocks of the first log before those of the second
    """

    logs: tuple[LogGrams, LogGrams]
    indices: tuple[Indices, Indices]
    blocks: Array
    tempering: float

    @property
    def n_directions(self) -> int:
        return self.logs[0].n_directions

    @cached_property
    def samples(self) -> Array:
        """Return how many readings take part in each block, (B,)."""
        return np.concatenate([log.evaluation.samples_per_block().sum(axis=1) for log in self.logs])

    @cached_property
    def raw_squares(self) -> Array:
        """Return the squares of the columns of the joint coordinates, (P,)."""
        total = np.zeros(self.blocks.shape[1] - self.n_directions - 1)
        for log, place in zip(self.logs, self.indices, strict=True):
            total[place] += log.raw_squares[self.n_directions :]
        return total

    @cached_property
    def prior(self) -> CoordinatePrior:
        """Return the prior of the joint coordinates."""
        information, value = np.zeros((2, len(self.raw_squares)))
        for log, place in zip(self.logs, self.indices, strict=True):
            prior = build_prior(log.terms, len(place), self.tempering)
            information[place], value[place] = prior.information, prior.value
        return CoordinatePrior(information, value, self.tempering)

    def fit(self) -> JointFit:
        """Return the fit of the joint coordinates alone."""
        remaining = slice(self.n_directions, None)
        return self._fit(self.blocks[:, remaining, remaining], self.raw_squares, self.prior)

    def fit_candidate(self, candidate: Candidate, is_known: bool) -> tuple[JointFit, JointFit]:
        """Return the fits with a value of a candidate common to both logs, and with a value for each.

        is_known: True if the candidate is one of the free terms, so that the common value is fitted anyway

        The last k coordinates of the second fit are the change from the first log to the second.
        """
        rows = np.flatnonzero(candidate.basis.any(axis=1))
        basis, k = candidate.basis[rows], candidate.basis.shape[1]
        remaining = [*range(self.n_directions, self.blocks.shape[1] - 1)]
        columns = np.zeros((self.blocks.shape[1], len(remaining) + (1 if is_known else 2) * k + 1))
        columns[remaining, range(len(remaining))] = 1.0
        columns[-1, -1] = 1.0
        if not is_known:
            columns[rows, len(remaining) : len(remaining) + k] = basis
        used = np.append(rows, np.arange(self.n_directions, self.blocks.shape[1]))
        common = _transform(self.blocks, used, np.delete(columns, np.s_[-k - 1 : -1], axis=1))
        columns[rows, -k - 1 : -1] = basis
        is_after = np.arange(len(self.blocks)) >= len(self.logs[0].blocks)
        separate = np.empty((len(self.blocks), columns.shape[1], columns.shape[1]))
        separate[is_after] = _transform(self.blocks[is_after], used, columns)
        columns[rows, -k - 1 : -1] = 0.0
        separate[~is_after] = _transform(self.blocks[~is_after], used, columns)
        raw = [basis.T**2 @ log.raw_squares[rows] for log in self.logs]
        prior = build_prior([candidate.term], k, self.tempering).information
        n_common = common.shape[1] - 1
        raw_squares = np.concatenate([self.raw_squares, *([] if is_known else [raw[0] + raw[1]]), raw[1]])
        information = np.concatenate([self.prior.information, *([] if is_known else [prior]), prior])
        value = np.append(self.prior.value, np.zeros(len(information) - len(self.prior.value)))
        return (
            self._fit(
                common,
                raw_squares[:n_common],
                CoordinatePrior(information[:n_common], value[:n_common], self.tempering),
            ),
            self._fit(separate, raw_squares, CoordinatePrior(information, value, self.tempering)),
        )

    def fit_equal(self, before: Indices, after: Indices, difference: Array) -> JointFit:
        """Return the fit of the joint coordinates with equal values of a term in both logs.

        before, after: its coordinates
        difference: (k,) its present value in the second log less that in the first, in scales

        Other coordinates that would leave the range in which the model is linear stay as they are.
        """
        size = len(self.raw_squares) + 1
        transform = np.eye(size)
        transform[after, before] = 1.0
        transform[after, -1] = difference
        remaining = np.delete(np.arange(size), after)
        columns = slice(self.n_directions, None)
        blocks = transform[:, remaining].T @ self.blocks[:, columns, columns] @ transform[:, remaining]
        raw_squares = (transform[:-1, :-1].T ** 2 @ self.raw_squares)[remaining[:-1]]
        prior = CoordinatePrior(
            self.prior.information[remaining[:-1]], self.prior.value[remaining[:-1]], self.tempering
        )
        is_own = np.isin(remaining[:-1], before)
        while True:
            fit = self._fit(blocks, raw_squares, prior)
            is_far = ~is_own & (np.abs(fit.step) > MAX_STEP_SCALES)
            if not is_far.any():
                return fit
            prior = prior.freeze(is_far)

    def _fit(self, blocks: Array, raw_squares: Array, prior: CoordinatePrior) -> JointFit:
        log_determinant = sum(log.log_determinant for log in self.logs)
        return JointFit(blocks, raw_squares, prior, self.samples, log_determinant)


def _transform(blocks: Array, used: Indices, columns: Array) -> Array:
    """Return blocks projected onto columns, (S, P); only the `used` rows of a block count."""
    selected = columns[used]
    return np.asarray(selected.T @ blocks[:, used[:, None], used] @ selected)


def join_logs(
    before: LogGrams, after: LogGrams, separate: Collection[EffectKey], tempering: float
) -> JointGrams:
    """Join two logs with the same free terms, of which the `separate` ones have a value for each log."""
    members: tuple[list[int], list[int]] = ([], [])
    count = 0
    for term in before.terms:
        size = len(term.effect.coordinates())
        members[0].extend(range(count, count + size))
        count += size if term.key in separate else 0
        members[1].extend(range(count, count + size))
        count += size
    for place, log in zip(members, (before, after), strict=True):
        n_nuisances = len(log.raw_squares) - before.n_directions - len(place)
        place.extend(range(count, count + n_nuisances))
        count += n_nuisances
    blocks = np.zeros((len(before.blocks) + len(after.blocks), *[before.n_directions + count + 1] * 2))
    first = 0
    for place, log in zip(members, (before, after), strict=True):
        rows = _joint_rows(before.n_directions, place, count)
        blocks[first : first + len(log.blocks), rows[:, None], rows] = log.blocks
        first += len(log.blocks)
    indices = (np.array(members[0], np.intp), np.array(members[1], np.intp))
    return JointGrams((before, after), indices, blocks, tempering)


def _joint_rows(n_directions: int, place: Sequence[int], count: int) -> Indices:
    return np.array([*range(n_directions), *(n_directions + k for k in place), n_directions + count], np.intp)
