"""Comparison of filters of one gyro axis on a log: constants from the first half, errors on the second.

With a reference the error is that of the rate. Without one it is that of predicting the next sample, whose
noise is the same for all filters; if the noise of neighbouring samples is correlated, as behind a low-pass
filter, this favours fast filters.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.recording import Recording, Table
from hubodo.sensors.filters.bench import FilterBench
from hubodo.sensors.filters.bias import (
    BiasEstimate,
    Spans,
    estimate_static_biases,
    find_standstill_spans,
    spans_of_times,
)
from hubodo.sensors.filters.candidates import StaticState
from hubodo.sensors.filters.reference import Reference, align_reference, read_reference
from hubodo.sensors.filters.result import FilterComparison
from hubodo.sensors.saturation import saturated_value

_MIN_COMPARED_SAMPLES = 400
_MAX_SAMPLES = 60_000
"""The six-state filter and RLS run sample by sample; a longer record hardly changes the errors."""
_MAX_GAP_INTERVALS = 10.0
_MIN_MOTION_SIGMA = 5.0
"""Ratio of the rate's standard deviation to the noise from which a record counts as moving."""
_MAX_WHITE_CORRELATION = 0.2
_SLOW_TIME = 0.5  # s
_MAX_SLOW_SHARE = 0.9
"""Share of the error variance that is slower than `_SLOW_TIME`, from which a reference is doubtful."""
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
    bench = FilterBench(initial, samples, truth, half, is_moving)
    scores = bench.score(bench.tuned_candidates())
    notes += _remarks(samples, spans, aligned, is_moving)
    if aligned is not None:
        errors = scores[0].errors[bench.judged]
        notes += _doubt_reference(aligned, errors, dt, scores[0].tuning_error, scores[0].error)
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
    """Return the longest part of the span without gaps, limited to `_MAX_SAMPLES` rows."""
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


def _doubt_reference(
    reference: Reference, errors: Array, dt: float, tuning_error: float, error: float
) -> list[str]:
    """Return reasons why the reference may not turn as the gyro does, from the errors of the raw samples.

    errors: rad/s, of the second half. tuning_error, error: rms of the first and of the second half, rad/s.
    """
    notes = []
    first, second = math.degrees(tuning_error), math.degrees(error)
    if second > _MAX_ERROR_RATIO * first:
        notes.append(
            f"{reference.name} departs from the raw samples by {second:.3g} deg/s rms in the second half, by "
            f"{first:.3g} in the first: it may turn differently"
        )
    share = _slow_share(errors, dt)
    if share > _MAX_SLOW_SHARE:
        notes.append(
            f"{100.0 * share:.0f} % of the error variance of the raw samples is slower than "
            f"{_SLOW_TIME:g} s, which no filter removes: {reference.name} turns differently, or the scale of "
            "the gyro varies"
        )
    return notes


def _slow_share(errors: Array, dt: float) -> float:
    """Return the share of the variance of the errors that remains in their means over `_SLOW_TIME`."""
    count = max(int(_SLOW_TIME / dt), 2)
    known = errors[np.isfinite(errors)]
    known = known[: len(known) // count * count]
    power = float(known @ known)
    means = known.reshape(-1, count).mean(axis=1)
    return float(means @ means) * count / power if power else 0.0


def _remarks(samples: Array, spans: Spans, reference: Reference | None, is_moving: bool) -> list[str]:
    """Return remarks on the data and the criterion of the comparison."""
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
            f"{reference.name}: delay {reference.delay * 1e3:+z.1f} ms against the gyro and scale removed, "
            "both fitted to the first half"
        )
    return notes
