"""Comparison of filters of one gyro axis on a log: constants from the first half, errors on the second.

With a reference the error is that of the rate. Without one it is that of predicting the next sample, whose
noise is the same for all filters; if the noise of neighbouring samples is correlated, as behind a low-pass
filter, this favours fast filters.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.recording import Recording, Table
from hubodo.sensors.filters.bias import (
    BiasEstimate,
    Spans,
    estimate_static_biases,
    find_standstill_spans,
    spans_of_times,
)
from hubodo.sensors.filters.candidates import (
    FilterCandidate,
    StaticState,
    kalman,
    moving_average,
    raw,
    recursive_least_squares,
    six_state,
)
from hubodo.sensors.filters.reference import Reference, align_reference, measure_delay, read_reference
from hubodo.sensors.filters.result import FilterComparison, FilterScore
from hubodo.sensors.saturation import saturated_value

_MIN_COMPARED_SAMPLES = 400
_MAX_SAMPLES = 60_000
"""The six-state filter and RLS run sample by sample; a longer record hardly changes the errors."""
_MAX_GAP_INTERVALS = 10.0
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
_MIN_MOTION_SIGMA = 5.0
"""Ratio of the rate's standard deviation to the noise from which a record counts as moving."""
_MAX_WHITE_CORRELATION = 0.2
_MAX_ERROR_RATIO = 5.0
"""Ratio of the raw errors of both halves from which the reference itself is doubtful."""


def compare_filters(
    recording: Recording,
    node: str,
    channel: str,
    *,
    reference: str | None = None,
    standstills: Sequence[Sequence[float]] = (),
    start: float | None = None,
    end: float | None = None,
) -> FilterComparison:
    """Compare the filters of one gyro axis of a node.

    reference: TABLE or TABLE.COLUMN with the true rate, angle or wheel speed, or None. standstills: (from,
    to) of each, s; detected if empty. start, end: span of the log, s. Raises InputError for a missing
    channel, too few samples, or an unusable reference.
    """
    notes: list[str] = []
    table = _usable_rows(recording.nodes[node], channel, start, end, notes)
    t, samples = table.t, table[channel]
    dt = float(np.median(np.diff(t)))
    half = len(t) // 2
    spans = (
        spans_of_times(t, standstills)
        if standstills
        else find_standstill_spans(t, table.gyro, table.accel, samples)
    )
    biases = estimate_static_biases(table.gyro, "xyz".index(channel[1]), spans) if spans else ()
    aligned, truth = None, None
    if reference is not None:
        unaligned = read_reference(recording, reference, node, channel)
        aligned = align_reference(unaligned, t[:half], samples[:half], dt)
        truth = np.interp(t, aligned.t, aligned.rate, left=np.nan, right=np.nan)
        if np.isfinite(truth[half:]).sum() < _MIN_COMPARED_SAMPLES // 4:
            raise InputError(
                f"{aligned.name} ends in the first half of the samples; the second half is judged"
            )
    initial = _initial_state(samples, dt, spans, biases, aligned)
    is_moving = min(float(np.std(part)) for part in (samples[:half], samples[half:])) > (
        _MIN_MOTION_SIGMA * initial.noise
    )
    bench = _Bench(initial, samples, truth, half, is_moving)
    scores = bench.score(bench.tuned_candidates())
    notes += _remarks(samples, spans, aligned, is_moving)
    first, second = (math.degrees(error) for error in (scores[0].tuning_error, scores[0].error))
    if aligned is not None and second > _MAX_ERROR_RATIO * first:
        notes.append(
            f"{aligned.name} departs from the raw samples by {second:.3g} deg/s rms in the second half, by "
            f"{first:.3g} in the first: it may turn differently"
        )
    return FilterComparison(
        node=node,
        channel=channel,
        dt=dt,
        t=t,
        samples=samples,
        truth=truth,
        reference=aligned,
        standstills=tuple((float(t[i]), float(t[j - 1])) for i, j in spans),
        standstill_samples=np.concatenate([samples[i:j] for i, j in spans] or [samples[:0]]),
        biases=biases,
        initial=initial,
        scores=scores,
        is_moving=is_moving,
        chosen=bench.choose(scores),
        notes=tuple(notes),
    )


def _check_samples(samples: Array, channel: str, notes: list[str]) -> None:
    """Raise InputError for a gyro that never changes; add a remark for a saturated one."""
    if np.ptp(samples) == 0.0:
        raise InputError(
            f"all samples of {channel} equal {samples[0]:.6g}: the sensor is stuck or not connected"
        )
    saturated = saturated_value(samples)
    if saturated is not None:
        notes.append(
            f"{saturated[1]:.0%} of the samples equal {math.degrees(saturated[0]):.4g} deg/s, like those of "
            "a saturated gyro: errors beyond the end of its range are not judged"
        )


def _usable_rows(
    table: Table, channel: str, start: float | None, end: float | None, notes: list[str]
) -> Table:
    """Return the longest part of the span without gaps, at most `_MAX_SAMPLES` rows."""
    bounds = (-math.inf if start is None else start, math.inf if end is None else end)
    span = np.zeros(len(table), bool)
    span[slice(*np.searchsorted(table.t, bounds))] = True
    rows = np.flatnonzero(span & np.isfinite(table[channel]))
    if not span.any() and len(table):
        raise InputError(
            f"has no samples between --start and --end; they are from {table.t[0]:.6g} to {table.t[-1]:.6g} s"
        )
    if not len(rows):
        measured = [name for name in ("gx", "gy", "gz") if np.isfinite(table[name]).any()]
        raise InputError(f"has no {channel}; use --channel with {', '.join(measured) or 'another node'}")
    intervals = np.diff(table.t[rows])
    gaps = (
        np.flatnonzero(intervals > _MAX_GAP_INTERVALS * np.median(intervals)) if len(intervals) else rows[:0]
    )
    parts = np.split(rows, gaps + 1)
    longest = max(parts, key=len)
    if len(parts) > 1:
        t = table.t[longest]
        notes.append(f"{len(parts) - 1} gaps; compared on the longest part, {t[0]:.6g} to {t[-1]:.6g} s")
    if len(longest) > _MAX_SAMPLES:
        notes.append(
            f"compared on the first {_MAX_SAMPLES} of {len(longest)} samples; choose others by --start"
        )
        longest = longest[:_MAX_SAMPLES]
    if len(longest) < _MIN_COMPARED_SAMPLES:
        raise InputError(
            f"{len(longest)} samples without a gap are too few; at least {_MIN_COMPARED_SAMPLES} are needed"
        )
    _check_samples(table[channel][longest], channel, notes)
    return Table({name: table[name][longest] for name in table})


def _initial_state(
    samples: Array,
    dt: float,
    spans: Spans,
    biases: Sequence[BiasEstimate],
    reference: Reference | None,
) -> StaticState:
    """Return bias and noise: from standstills, else bias from the reference and noise from differences."""
    if spans:
        pieces = [samples[i:j] - samples[i:j].mean() for i, j in spans]
        count = sum(map(len, pieces))
        noise = math.sqrt(sum(float(piece @ piece) for piece in pieces) / count)
        return StaticState(dt, biases[0].bias, max(noise, 1e-12), count)
    # Second differences remove a rate that changes linearly; white noise has a variance of 6 in them.
    noise = float(np.median(np.abs(np.diff(samples, 2)))) / 0.6745 / math.sqrt(6.0)
    return StaticState(dt, 0.0 if reference is None else reference.offset, max(noise, 1e-12), 1)


class _Bench:
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
        averages = [moving_average(initial, width) for width in _WIDTHS]
        gains = [kalman(initial, gain) for gain in _RATE_GAINS]
        best_gain = self._best(gains)
        if self.truth is not None:
            rate_gain = best_gain.constants["rate_gain"]
            best_gain = self._best(
                [best_gain, *(kalman(initial, rate_gain, rate_gain * ratio) for ratio in _BIAS_GAIN_RATIOS)]
            )
        forgetting = [recursive_least_squares(initial, factor) for factor in _FORGETTING_GRID]
        derivatives = [six_state(initial, value) for value in _HIGHEST_DERIVATIVES]
        return [
            raw(initial),
            self._best(averages),
            best_gain,
            *(recursive_least_squares(initial, factor) for factor in _PAPER_FORGETTING_FACTORS),
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
                    _rms(tuned),
                    _rms(judged),
                    self._delay(rates),
                    candidate.seconds_per_sample(self.samples),
                )
            )
        return tuple(scores)

    def choose(self, scores: Sequence[FilterScore]) -> FilterScore | None:
        """Return the node's filter with the smallest error, raw unless the gain is significant.

        None for a record without motion, where the longest memory is the best and would lag on a wheel.
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
                candidates, key=lambda it: _rms(self._errors(it.run(self.samples[: self.half]))[self.tuned])
            )
        settled = slice(part.start + min(_SETTLED_SAMPLES, (part.stop - part.start) // 4), part.stop)

        def error(candidate: FilterCandidate) -> float:
            rates = np.full(part.stop, np.nan)
            rates[part] = candidate.run(self.samples[part])
            return _rms(self._errors(rates)[settled])

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


def _rms(errors: Array) -> float:
    known = errors[np.isfinite(errors)]
    return math.sqrt(float(known @ known) / len(known)) if len(known) else math.nan


def _remarks(samples: Array, spans: Spans, reference: Reference | None, is_moving: bool) -> list[str]:
    """Return remarks on what the comparison is based on."""
    notes = []
    if not spans:
        source = "zero" if reference is None else f"the offset against {reference.name}"
        notes.append(f"no standstill: the bias is {source}, the noise that of differences; give --rest")
    if not is_moving:
        notes.append(
            "the axis does not rotate in both halves of the record: a long memory costs nothing here and "
            "would lag on a wheel, so no filter is recommended; record a drive"
        )
    if reference is None:
        notes.append(
            "no --reference: the error is that of predicting the next sample, which contains its noise"
        )
        longest = max(spans, key=lambda span: span[1] - span[0], default=(0, 0))
        stationary = samples[slice(*longest)] - samples[slice(*longest)].mean() if spans else samples[:0]
        power = float(stationary @ stationary)
        correlation = float(stationary[1:] @ stationary[:-1]) / power if power else 0.0
        if correlation > _MAX_WHITE_CORRELATION:
            notes.append(
                f"the noise of neighbouring samples is correlated ({correlation:.2f} at standstill), which "
                "favours fast filters in this comparison; give a --reference"
            )
    else:
        notes.append(
            f"{reference.name}: delay {reference.delay * 1e3:+.1f} ms against the gyro and scale removed, "
            "both fitted to the first half"
        )
    return notes
