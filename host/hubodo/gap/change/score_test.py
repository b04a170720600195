"""Two logs under one model: what each candidate gains where the second has its own value (a score test).

Whatever was found is common to both and free, and so is the candidate itself; what is tested is the
difference alone, so a thing that neither log knows well is no change. Chance is what the best of all gains
when the signs of blocks of time are drawn anew, as in `screen/null_distribution.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
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


@dataclass(frozen=True)
class Difference:
    """What a candidate gains of ln likelihood where the second log has its own; freedom: coordinates seen."""

    candidate: Candidate
    gain: float
    degrees_of_freedom: int


@dataclass(frozen=True)
class Comparison:
    """differences: the most surprising first. null: what the best of them gains by chance."""

    differences: tuple[Difference, ...]
    null_distribution: NullDistribution

    @property
    def p_value(self) -> float:
        """How often the logs differ as much as this where nothing has changed."""
        best = self.differences[0]
        return self.null_distribution.p_value(best.gain, best.degrees_of_freedom)


def compare_logs(evaluation_before: Evaluation, evaluation_after: Evaluation) -> Comparison:
    """Every candidate, from two points of one model with the same values; the logs have the same nodes."""
    directions = list_directions(evaluation_before.state)
    logs = [
        _eliminate_nuisances(linearise(evaluation_before, directions)),
        _eliminate_nuisances(linearise(evaluation_after, list_directions(evaluation_after.state))),
    ]
    options = list_candidates(evaluation_before.problem, directions)
    known = {term.key for term in evaluation_before.state.terms if term.effect.visible_in == "mean"}
    common = [it.basis for it in options if it.term.key in known]
    made, tests, columns = [], [], list[Array]()
    for candidate in options:
        beside = common if candidate.term.key in known else [*common, candidate.basis]
        gain, scores, covariance = _score_difference(logs, candidate.basis, np.hstack(beside))
        freedom = int(np.count_nonzero(np.diag(covariance)))
        if freedom:
            place = np.zeros((sum(it.shape[1] for it in columns) + scores.shape[1], scores.shape[1]))
            place[-scores.shape[1] :] = np.eye(scores.shape[1])
            columns.append(scores)
            tests.append(ScoreTest(place, covariance))
            made.append(Difference(candidate, gain, freedom))
    made.sort(key=lambda it: -float(compute_surprise(np.array(it.gain), it.degrees_of_freedom)))
    return Comparison(tuple(made), draw_null_distribution(np.hstack(columns), tests))


@dataclass(frozen=True)
class _ReducedLog:
    """A linearised log without its nuisances. blocks: (B, D+1, D+1). raw: (D,)."""

    blocks: Array
    raw: Array

    @property
    def gram(self) -> Array:
        return np.asarray(self.blocks.sum(axis=0))


def _eliminate_nuisances(linear: Linearisation) -> _ReducedLog:
    """With the nuisances where the log wants them."""
    count = len(linear.directions)
    kept = [*range(count), len(linear.gram) - 1]
    if not linear.n_nuisances:
        return _ReducedLog(linear.block_grams.unpack(), linear.raw_squares[:-1])
    gram, free = linear.gram, linear.nuisance_indices
    out = np.linalg.pinv(gram[np.ix_(free, free)], hermitian=True) @ gram[free]
    turn = np.eye(len(gram))
    turn[free] -= out
    turn = turn[:, kept]
    return _ReducedLog(
        np.einsum("dk,bde,ef->bkf", turn, linear.block_grams.unpack(), turn, optimize=True),
        linear.raw_squares[:count],
    )


def _score_difference(logs: Sequence[_ReducedLog], basis: Array, common: Array) -> tuple[float, Array, Array]:
    """Gain, (B, k) scores of blocks and (k, k) covariance of the second value less the first.

    What is common moves along `common`, (D, p), in both; the difference by half of it, down in the first log
    and up in the second.
    """
    signs = (-0.5, 0.5)
    grams = [log.gram for log in logs]
    whole = np.sum([common.T @ gram[:-1, :-1] @ common for gram in grams], axis=0)
    pull = np.sum([common.T @ gram[:-1, -1] for gram in grams], axis=0)
    across = sum(sign * basis.T @ gram[:-1, :-1] @ common for sign, gram in zip(signs, grams, strict=True))
    inverse = np.linalg.pinv(whole, hermitian=True, rcond=1e-10)
    settled, shared = inverse @ pull, np.asarray(across @ inverse)
    blocks, total, information = [], np.zeros(basis.shape[1]), np.zeros((basis.shape[1],) * 2)
    for log, sign, gram in zip(logs, signs, grams, strict=True):
        along = sign * basis - common @ shared.T
        own = common.T @ log.blocks[:, :-1, :-1] @ common
        # Where the others alone would have it; half way there, blocks scatter as if they had not been fitted.
        others = (
            np.linalg.pinv(whole - own, hermitian=True, rcond=1e-6)
            @ (pull - log.blocks[:, :-1, -1] @ common)[:, :, None]
        )
        fitted = 0.5 * (settled + others[:, :, 0]) @ common.T
        scores = log.blocks[:, :-1, -1] - np.einsum("bde,be->bd", log.blocks[:, :-1, :-1], fitted)
        blocks.append(scores @ along)
        total += sign * basis.T @ gram[:-1, -1] - shared @ (common.T @ gram[:-1, -1])
        information += along.T @ gram[:-1, :-1] @ along
    raw = 0.25 * basis.T**2 @ np.sum([log.raw for log in logs], axis=0)
    covariance = invert_information(information, raw)
    return 0.5 * float(total @ covariance @ total), np.concatenate(blocks), covariance
