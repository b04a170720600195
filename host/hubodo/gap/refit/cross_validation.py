"""Cross-validation of a linearised fit over folds of time, from the gram matrices of its blocks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.gap.linear.linearisation import invert_information
from hubodo.gap.refit.prior import CoordinatePrior

# Blocks per fold, so that a fold is longer than the correlation of roads and manoeuvres, some ten seconds;
# smallest and largest number of folds, the latter that of a log of two minutes.
_BLOCKS_PER_FOLD, _MIN_FOLDS, _MAX_FOLDS = 3, 4, 12


@dataclass(frozen=True)
class FoldDeviances:
    """Deviances of F folds of time.

    held_out: (F,) deviance of each fold under the fit to all other folds
    own: (F,) deviance of each fold under the fit to all folds
    samples: (F,) readings in each fold
    """

    held_out: Array
    own: Array
    samples: Array

    @property
    def level_scatter(self) -> float:
        """Return 1 sigma of the total deviance due to noise whose level differs from fold to fold."""
        return compute_level_scatter(self.own, self.samples)


def compute_level_scatter(squares: Array, samples: Array) -> float:
    """Return 1 sigma of the total deviance due to noise whose level differs from fold to fold.

    squares: (F,) deviance of each fold
    samples: (F,) readings in each fold

    In white noise of the assumed level a fold of n samples scatters by √(2 n); twice that variance is left to
    chance. The excess is attributed to road, engine and manoeuvres that no model describes.
    """
    count = len(samples)
    level = float(squares.sum() / max(samples.sum(), 1.0))
    scatter = squares - level * samples
    variance = float(scatter @ scatter) * count / max(count - 1, 1)
    return float(np.sqrt(max(variance - 4.0 * level**2 * samples.sum(), 0.0)))


@dataclass(frozen=True)
class HeldOutGain:
    """Gain in log-likelihood on samples that a fit has not seen.

    total: sum over all folds
    sigma: 1 sigma of the total, from the scatter of the folds about a constant share of their own gains
    level_sigma: 1 sigma of the log-likelihood due to noise whose level differs from fold to fold
    max_doubt: largest gain that is in doubt at any level
    own_folds: gain of each fold under the fit to all folds
    """

    total: float
    sigma: float
    level_sigma: float
    max_doubt: float = np.inf
    own_folds: tuple[float, ...] = ()

    @property
    def z(self) -> float:
        """Return the gain in sigma."""
        return self.total / self.sigma if self.sigma > 0.0 else 0.0


@dataclass(frozen=True)
class FoldGrams:
    """Gram matrices of F folds of time.

    grams: (F, P+1, P+1) of coordinates and residual, whose row is the last
    raw_squares: (P,) squares of the columns, below a share of which information is rounding error
    samples: (F,) readings in each fold
    """

    grams: Array
    raw_squares: Array
    samples: Array

    @staticmethod
    def of_blocks(blocks: Array, raw_squares: Array, samples: Array) -> FoldGrams:
        """Return the folds of consecutive blocks, (B, P+1, P+1), with `samples` readings each, (B,)."""
        return FoldGrams(sum_folds(blocks), raw_squares, sum_folds(samples))

    @staticmethod
    def of_groups(blocks: Array, raw_squares: Array, samples: Array, max_groups: int) -> FoldGrams:
        """Return folds of as few blocks as give at most `max_groups`."""
        count = min(len(blocks), max_groups)
        return FoldGrams(_sum_parts(blocks, count), raw_squares, _sum_parts(samples, count))

    def cross_validate(self, prior: CoordinatePrior) -> FoldDeviances:
        """Return the deviances of the folds; `prior` is that of the coordinates.

        For a linear model with information A and score b the other folds give the step d = A⁻¹ b, and the
        deviance of the fold is r'r - 2 d'b_f + d'A_f d (Stone 1974).
        """
        total, deviances = self.grams.sum(axis=0), np.empty((2, len(self.grams)))
        fit_to_all = self.fit_step(total, prior)
        for k, fold in enumerate(self.grams):
            for row, step in enumerate((self.fit_step(total - fold, prior), fit_to_all)):
                deviances[row, k] = fold[-1, -1] - 2.0 * step @ fold[:-1, -1] + step @ fold[:-1, :-1] @ step
        return FoldDeviances(deviances[0], deviances[1], self.samples)

    def fit_step(self, gram: Array, prior: CoordinatePrior) -> Array:
        """Return the step, (P,), of a fit to the samples of a gram matrix."""
        covariance = invert_information(gram[:-1, :-1], self.raw_squares, prior.information)
        return np.asarray(covariance @ (gram[:-1, -1] - prior.gradient))


def sum_folds(blocks: Array) -> Array:
    """Return the sums of consecutive blocks of time, (F, ...), over the first axis."""
    count = int(np.clip(len(blocks) // _BLOCKS_PER_FOLD, min(_MIN_FOLDS, len(blocks)), _MAX_FOLDS))
    return _sum_parts(blocks, count)


def _sum_parts(blocks: Array, count: int) -> Array:
    return np.array([part.sum(axis=0) for part in np.array_split(blocks, count)])


def compute_held_out_gain(before: FoldDeviances, after: FoldDeviances) -> HeldOutGain:
    """Return the gain of one fit over another, from their deviances of the same folds.

    A fold that is badly predicted by the others would dominate, so no fold counts more than twice its own
    gain. A true effect gains about the same share of each fold's own gain, however unevenly a drive shows it.
    """
    own = 0.5 * (before.own - after.own)
    held_out = np.minimum(0.5 * (before.held_out - after.held_out), 2.0 * np.maximum(own, 0.0))
    total = float(held_out.sum())
    share = total / max(float(own.sum()), 1e-9)
    scatter = held_out - share * own
    sigma = float(np.sqrt(scatter @ scatter * len(own) / max(len(own) - 1, 1)))
    return HeldOutGain(total, sigma, 0.5 * after.level_scatter, own_folds=tuple(own.tolist()))


def compare_gains(one: HeldOutGain, other: HeldOutGain) -> tuple[float, float]:
    """Return by how much one fit gains more than another of as many coordinates, and that in sigma.

    Whatever varies from fold to fold for both alike, such as the level of the noise, cancels.

    References: Q. H. Vuong, Likelihood ratio tests for model selection and non-nested hypotheses, 1989.
    """
    advantage = np.array(one.own_folds) - np.array(other.own_folds)
    if len(advantage) < 2:
        return 0.0, 0.0
    sigma = float(np.std(advantage, ddof=1)) * np.sqrt(len(advantage))
    total = float(advantage.sum())
    return total, total / max(sigma, 1e-9)
