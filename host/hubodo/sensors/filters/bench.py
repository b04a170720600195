"""Tuning of the filters of one gyro axis on the first half of its samples, and their errors on the second."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from hubodo.arrays import Array
from hubodo.sensors.filters.candidates import (
    FilterCandidate,
    StaticState,
    kalman_candidate,
    moving_average_candidate,
    raw_candidate,
    recursive_least_squares_candidate,
    six_state_candidate,
)
from hubodo.sensors.filters.reference import measure_delay
from hubodo.sensors.filters.result import FilterScore

_RATE_GAINS = np.geomspace(0.003, 0.95, 24).tolist()
_BIAS_GAIN_RATIOS = (0.0, 1e-6, 1e-5, 1e-4, 1e-3)
"""Gain of the bias relative to that of the rate; it needs a reference, since only rate + bias is observed."""
_FORGETTING_GRID = (0.5, 0.7, 0.8, 0.9, 0.95, 0.97, 0.99, 0.995, 0.999)
_PAPER_FORGETTING_FACTORS = (0.98, 0.92)
_WIDTHS = (2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 100, 200)
_HIGHEST_DERIVATIVES = np.geomspace(1e-3, 1e7, 11).tolist()  # rad/s^3
_SIX_STATE_TUNING_SAMPLES = 6_000
_SETTLED_SAMPLES = 100
"""Samples at the beginning that are not judged, while the filters converge."""
_COMPARED_BLOCKS = 20
_MIN_IMPROVEMENT_SIGMA = 2.0


class FilterBench:
    """Samples of one axis with the criterion by which filters are tuned and judged.

    truth: (N,) rad/s, NaN where unknown, or None: then the error is that of predicting the next sample.
    """

    def __init__(
        self, initial: StaticState, samples: Array, truth: Array | None, half: int, is_moving: bool
    ) -> None:
        self.initial, self.samples, self.truth, self.half = initial, samples, truth, half
        self.is_moving = is_moving
        self.tuned = slice(min(_SETTLED_SAMPLES, half // 4), half)
        self.judged = slice(half, len(samples) - 1)

    def tuned_candidates(self) -> list[FilterCandidate]:
        """Return every filter, with constants that minimise the error of the first half."""
        initial = self.initial
        averages = [moving_average_candidate(initial, width) for width in _WIDTHS]
        gains = [kalman_candidate(initial, gain) for gain in _RATE_GAINS]
        best_gain = self._best(gains)
        if self.truth is not None:
            rate_gain = best_gain.constants["rate_gain"]
            best_gain = self._best(
                [
                    best_gain,
                    *(kalman_candidate(initial, rate_gain, rate_gain * ratio) for ratio in _BIAS_GAIN_RATIOS),
                ]
            )
        forgetting = [recursive_least_squares_candidate(initial, factor) for factor in _FORGETTING_GRID]
        derivatives = [six_state_candidate(initial, value) for value in _HIGHEST_DERIVATIVES]
        return [
            raw_candidate(initial),
            self._best(averages),
            best_gain,
            *(recursive_least_squares_candidate(initial, factor) for factor in _PAPER_FORGETTING_FACTORS),
            self._best(forgetting),
            self._best(derivatives, self._tuning_part()),
        ]

    def score(self, candidates: Iterable[FilterCandidate]) -> tuple[FilterScore, ...]:
        """Return the errors of each candidate on the second half, with its delay and run time."""
        scores = []
        for candidate in candidates:
            rates = candidate.run(self.samples)
            errors = self._errors(rates)
            tuned, judged = errors[self.tuned], errors[self.judged]
            scores.append(
                FilterScore(
                    candidate,
                    rates,
                    errors,
                    rms(tuned),
                    rms(judged),
                    self._delay(rates),
                    candidate.seconds_per_sample(self.samples),
                )
            )
        return tuple(scores)

    def choose(self, scores: Sequence[FilterScore]) -> FilterScore | None:
        """Return the node's filter with the smallest error, raw unless the gain is significant.

        Returns None for a record without motion, where the longest memory is best but would lag on a wheel.
        """
        if not self.is_moving:
            return None
        best = scores[0]
        for score in scores[1:]:
            if score.candidate.settings is None or score.error >= best.error:
                continue
            gain = scores[0].errors[self.judged] ** 2 - score.errors[self.judged] ** 2
            blocks = np.array(
                [part.mean() for part in np.array_split(gain[np.isfinite(gain)], _COMPARED_BLOCKS)]
            )
            standard_error = float(blocks.std(ddof=1)) / math.sqrt(_COMPARED_BLOCKS)
            if float(blocks.mean()) > _MIN_IMPROVEMENT_SIGMA * standard_error:
                best = score
        return best

    def _best(self, candidates: Iterable[FilterCandidate], part: slice | None = None) -> FilterCandidate:
        """Return the candidate with the smallest error in the first half, or in a part of it."""
        if part is None:
            return min(
                candidates, key=lambda it: rms(self._errors(it.run(self.samples[: self.half]))[self.tuned])
            )
        settled = slice(part.start + min(_SETTLED_SAMPLES, (part.stop - part.start) // 4), part.stop)

        def error(candidate: FilterCandidate) -> float:
            rates = np.full(part.stop, np.nan)
            rates[part] = candidate.run(self.samples[part])
            return rms(self._errors(rates)[settled])

        return min(candidates, key=error)

    def _tuning_part(self) -> slice:
        """Return the part of the first half with the largest change of rate."""
        width = min(_SIX_STATE_TUNING_SAMPLES, self.half)
        starts = range(0, self.half - width + 1, max(1, width // 4))
        first = max(starts, key=lambda k: float(np.std(self.samples[k : k + width])))
        return slice(first, first + width)

    def _errors(self, rates: Array) -> Array:
        """Return the error after each sample, rad/s; one fewer than rates without truth."""
        if self.truth is not None:
            return np.asarray(rates - self.truth[: len(rates)])
        following = self.samples[1 : len(rates) + 1] - self.initial.bias
        return np.asarray(rates[: len(following)] - following)

    def _delay(self, rates: Array) -> float | None:
        """Return the delay beyond that of the raw samples, s, by truth if any; None without motion."""
        if not self.is_moving:
            return None
        samples, dt = self.samples[self.half :], self.initial.dt
        source = samples if self.truth is None else self.truth[self.half :]
        known = np.isfinite(source)
        source = source[known]
        delay = measure_delay(rates[self.half :][known], source, dt) - measure_delay(
            samples[known], source, dt
        )
        return delay if math.isfinite(delay) else None


def rms(errors: Array) -> float:
    """Return the root mean square of the finite errors; NaN without any."""
    known = errors[np.isfinite(errors)]
    return math.sqrt(float(known @ known) / len(known)) if len(known) else math.nan
