"""Score test for a change between two logs: the gain of each candidate with separate values.

Known effects and the candidate itself are fitted with values common to both logs; only the difference is
tested, so that poorly observed effects do not count as changes. The null distribution of the largest gain is
a wild bootstrap as in `screen/null_distribution.py`.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.gap.linear.linearisation import Linearisation, invert_information, linearise
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.screen.candidates import Candidate, list_candidates, list_directions
from hubodo.gap.screen.null_distribution import (
    NullDistribution,
    ScoreTest,
    compute_surprise,
    draw_null_distribution,
)
from hubodo.gap.state.terms import ALL, VEHICLE


@dataclass(frozen=True)
class Difference:
    """Gain of ln likelihood by separate values of a candidate, and the number of observable coordinates."""

    candidate: Candidate
    gain: float
    degrees_of_freedom: int


@dataclass(frozen=True)
class Comparison:
    """Score tests, the most significant first, and the null distribution of the largest gain."""

    differences: tuple[Difference, ...]
    null_distribution: NullDistribution

    @property
    def p_value(self) -> float:
        """Return the probability that logs differ as much if nothing has changed."""
        best = self.differences[0]
        return self.null_distribution.p_value(best.gain, best.degrees_of_freedom)


def compare_logs(
    evaluation_before: Evaluation, evaluation_after: Evaluation, separate: Collection[tuple[str, str]] = ()
) -> Comparison:
    """Test every candidate for a change, given evaluations of the same model and the same nodes.

    separate: effects and scopes with a value for each log, which are not tested
    """
    directions = list_directions(evaluation_before.state)
    logs = [
        _eliminate_nuisances(linearise(one, list_directions(one.state)), separate)
        for one in (evaluation_before, evaluation_after)
    ]
    all_candidates = list_candidates(evaluation_before.problem, directions)
    all_candidates = [item for item in all_candidates if item.term.key not in separate]
    known = {term.key for term in evaluation_before.state.terms if term.effect.visible_in == "mean"}
    common = [item.basis for item in all_candidates if item.term.key in known]
    differences, tests, columns = [], [], list[Array]()
    for candidate in all_candidates:
        fitted = common if candidate.term.key in known else [*common, candidate.basis]
        gain, scores, covariance = _score_difference(logs, candidate.basis, np.hstack(fitted))
        freedom = int(np.count_nonzero(np.diag(covariance)))
        if freedom:
            test_basis = np.zeros((sum(item.shape[1] for item in columns) + scores.shape[1], scores.shape[1]))
            test_basis[-scores.shape[1] :] = np.eye(scores.shape[1])
            columns.append(scores)
            tests.append(ScoreTest(test_basis, covariance))
            differences.append(Difference(candidate, gain, freedom))
    differences.sort(key=lambda item: -float(compute_surprise(np.array(item.gain), item.degrees_of_freedom)))
    return Comparison(tuple(differences), draw_null_distribution(np.hstack(columns), tests))


@dataclass(frozen=True)
class _ReducedLog:
    """A linearised log without its nuisances.

    blocks: (B, D+1, D+1)
    raw: (D,)
    """

    blocks: Array
    raw: Array

    @property
    def gram(self) -> Array:
        return np.asarray(self.blocks.sum(axis=0))


def _eliminate_nuisances(
    linearisation: Linearisation, separate: Collection[tuple[str, str]] = ()
) -> _ReducedLog:
    """Return the log with the nuisances, and the effects with a value for each log, at their optimum."""
    count = len(linearisation.directions)
    own = [
        k
        for k, one in enumerate(linearisation.directions)
        if (one.effect.name, one.node or VEHICLE) in separate or (one.effect.name, ALL) in separate
    ]
    nuisances = [*own, *linearisation.nuisance_indices]
    remaining = [*range(count), len(linearisation.gram) - 1]
    if not nuisances:
        return _ReducedLog(linearisation.block_grams.unpack(), linearisation.raw_squares[:-1])
    gram = linearisation.gram
    regression = np.linalg.pinv(gram[np.ix_(nuisances, nuisances)], hermitian=True) @ gram[nuisances]
    transform = np.eye(len(gram))
    transform[nuisances] -= regression
    transform = transform[:, remaining]
    return _ReducedLog(
        np.asarray(transform.T @ linearisation.block_grams.unpack() @ transform),
        linearisation.raw_squares[:count],
    )


def _score_difference(logs: Sequence[_ReducedLog], basis: Array, common: Array) -> tuple[float, Array, Array]:
    """Return gain, block scores (B, k) and covariance (k, k) of the difference between the logs.

    Common coordinates move along `common`, (D, p), in both logs; the difference moves half down in the first
    log and half up in the second.
    """
    signs = (-0.5, 0.5)
    grams = [log.gram for log in logs]
    common_information = np.sum([common.T @ gram[:-1, :-1] @ common for gram in grams], axis=0)
    common_score = np.sum([common.T @ gram[:-1, -1] for gram in grams], axis=0)
    cross_information = sum(
        sign * basis.T @ gram[:-1, :-1] @ common for sign, gram in zip(signs, grams, strict=True)
    )
    inverse = np.linalg.pinv(common_information, hermitian=True, rcond=1e-10)
    common_step, regression = inverse @ common_score, np.asarray(cross_information @ inverse)
    blocks, total, information = [], np.zeros(basis.shape[1]), np.zeros((basis.shape[1],) * 2)
    for log, sign, gram in zip(logs, signs, grams, strict=True):
        direction = sign * basis - common @ regression.T
        block_information = common.T @ log.blocks[:, :-1, :-1] @ common
        # The step is fitted to the other blocks. Halfway to it, block scores scatter as if they were not
        # fitted.
        step_without_block = (
            np.linalg.pinv(common_information - block_information, hermitian=True, rcond=1e-6)
            @ (common_score - log.blocks[:, :-1, -1] @ common)[:, :, None]
        )
        mean_step = 0.5 * (common_step + step_without_block[:, :, 0]) @ common.T
        scores = log.blocks[:, :-1, -1] - np.einsum("bde,be->bd", log.blocks[:, :-1, :-1], mean_step)
        blocks.append(scores @ direction)
        total += sign * basis.T @ gram[:-1, -1] - regression @ (common.T @ gram[:-1, -1])
        information += direction.T @ gram[:-1, :-1] @ direction
    raw = 0.25 * basis.T**2 @ np.sum([log.raw for log in logs], axis=0)
    covariance = invert_information(information, raw)
    return 0.5 * float(total @ covariance @ total), np.concatenate(blocks), covariance
