"""Detection of a step of the bias of a stationary sensor, as after a blow or a change of the supply."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array

_BLOCKS, _WINDOWS = 320, (4, 8, 16)
"""Number of means of the record; numbers of means compared before and after a step."""
_MIN_STEP_SIGMA = 6.0
"""Difference of adjacent means, relative to its usual size in the record, from which it is a step.

White noise, walks, flicker and warm-ups of 800 simulated records have sharp ones of up to 5.0.
"""
_CANDIDATES = 3
"""Largest differences of each window that are examined, as the beginning of a warm-up has a larger one."""
_MIN_SHARPNESS = 10.0
"""Twice the log likelihood ratio of a step and of a parabola through the same means."""


@dataclass(frozen=True)
class BiasStep:
    """A step of the bias: t, its time in s; change, in the unit of the samples."""

    t: float
    change: float


def find_bias_step(t: Array, values: Array) -> BiasStep | None:
    """Return the most significant step of a record, or None.

    t: (N,) s. values: (N,) samples or means; changes of a random walk, of flicker and of smooth curves are no
    steps.
    """
    size = max(1, len(values) // _BLOCKS)
    count = len(values) // size
    if count < 5 * max(_WINDOWS):
        return None
    means = values[: count * size].reshape(count, size).mean(axis=1)
    sums = np.concatenate([[0.0], np.cumsum(means)])
    best, best_score = None, _MIN_STEP_SIGMA
    for window in _WINDOWS:
        k = np.arange(window, count - window + 1)
        change = (sums[k + window] - 2.0 * sums[k] + sums[k - window]) / window
        scale = 1.4826 * float(np.median(np.abs(change - np.median(change))))
        score = np.abs(change) / max(scale, 1e-300)
        for _ in range(_CANDIDATES):
            at = int(np.argmax(score))
            if score[at] > best_score and _is_sharp(means[at : at + 2 * window]):
                best, best_score = (
                    BiasStep(float(t[(at + window) * size]), float(change[at])),
                    float(score[at]),
                )
            score[max(0, at - window) : at + window] = 0.0
    return best


def _is_sharp(means: Array) -> bool:
    """Return True if a step in the middle fits the means (2 W,) much better than a parabola does."""
    half = len(means) // 2
    # The mean in which the bias steps belongs to neither side.
    sides = [(means[: half - k], means[half - k + 1 :]) for k in (0, 1)] + [(means[:half], means[half:])]
    step = min(sum(float(((side - side.mean()) ** 2).sum()) for side in pair) for pair in sides)
    x = np.linspace(-1.0, 1.0, len(means))
    smooth = means - np.polynomial.Polynomial.fit(x, means, 2)(x)
    ratio = float(smooth @ smooth) / max(step, 1e-300)
    return bool(len(means) * np.log(ratio) > _MIN_SHARPNESS)
