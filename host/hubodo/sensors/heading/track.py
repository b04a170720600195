"""Heading from a recording of one gyro axis, with simple baselines for comparison."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.effects.warmup import WarmupModel
from hubodo.fuse.heading_filter import BiasNoise, HeadingFilter
from hubodo.sensors.heading.vertical_axis import Spans, VerticalAxis

_GAP_STEPS = 5.0


@dataclass(frozen=True)
class HeadingTrack:
    """The heading at M times relative to the first sample, anticlockwise seen from above.

    Attributes:
        t: (M,) s.
        heading, sigma: (M,) rad.
        bias, sigma_bias: (M,) of the axis including warm-up, rad/s.
        baselines: (M,) headings by name, rad: the integrated raw rate, and that minus its mean in the
            first standstill.
        gaps: (start, end) of the gaps without samples, s.
    """

    t: Array
    heading: Array
    sigma: Array
    bias: Array
    sigma_bias: Array
    baselines: dict[str, Array]
    gaps: tuple[tuple[float, float], ...]


def estimate_heading(
    axis: VerticalAxis,
    spans: Spans,
    model: WarmupModel,
    noise: BiasNoise,
    *,
    age: float = 0.0,
    scale_sigma: float = 0.0,
    lag: float = 0.0,
    step: float = 0.1,
    rounding: float = 0.0,
) -> HeadingTrack:
    """Run the heading filter over means of about `step` s.

    spans: standstills. model: warm-up of the axis. noise: noise of the bias. age: time since power-on at the
    first sample, s. scale_sigma: relative sigma of the scale factor, which is constant, so its error is
    proportional to the net turn. lag: delay of the gyro, s, which makes the heading late by that times the
    rate. In a gap the rate is interpolated linearly, with an error equal to the rms change of the rate
    elsewhere within half the gap's length. rounding: 1σ of means of the rate due to rounding, rad/s, both of
    the bias from standstills and of the rates of steady turns.
    """
    t = axis.t
    sample_interval = float(np.median(np.diff(t)))
    gap = np.diff(t) > _GAP_STEPS * sample_interval
    edges, at_rest = _mean_edges(t, spans, gap, max(1, round(step / sample_interval)))
    turned = _integrate(t, axis.rate)
    lengths, turns = np.diff(t[edges]), np.diff(turned[edges])
    mean_temperatures = (
        None if axis.temperature is None else 0.5 * np.add(*_edge_values(axis.temperature, edges))
    )
    filter_ = HeadingFilter(model, noise, age=age)
    rows = [(0.0, 0.0, model.c2, noise.offset)]
    for k, (dt, turn, is_stationary) in enumerate(
        zip(lengths.tolist(), turns.tolist(), at_rest, strict=True)
    ):
        gap_sigma = _rms_change(axis, 0.5 * dt) if gap[edges[k]] and edges[k + 1] == edges[k] + 1 else 0.0
        mean_temperature = None if mean_temperatures is None else float(mean_temperatures[k])
        filter_.update(
            turn / dt, dt, is_stationary=bool(is_stationary), temperature=mean_temperature, sigma=gap_sigma
        )
        state = filter_.state()
        rows.append((float(state.heading), state.sigma_heading, float(state.bias), state.sigma_bias))
    heading, sigma, bias, sigma_bias = np.array(rows).T
    raw = _integrate(t, axis.raw)
    baselines = {"integrated as it is": raw[edges]}
    if spans:
        first = float(axis.raw[slice(*spans[0])].mean())
        baselines["less the mean of the first standstill"] = (raw - first * (t - t[0]))[edges]
    return HeadingTrack(
        t[edges],
        heading,
        np.sqrt(
            sigma**2
            + (scale_sigma * heading) ** 2
            + (lag * _rate_changes(t[edges], turned[edges])) ** 2
            + 2.0 * (rounding * (t[edges] - t[0])) ** 2
        ),
        bias,
        sigma_bias,
        baselines,
        tuple((float(t[k]), float(t[k + 1])) for k in np.flatnonzero(gap)),
    )


def _rate_changes(t: Array, turned: Array) -> Array:
    """Return the (M,) differences of the rates from the first one, rad/s."""
    rates = np.gradient(turned, t)
    return np.asarray(rates - rates[0])


def _mean_edges(
    t: Array, spans: Spans, gap: NDArray[np.bool_], width: int
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the (M,) sample indices that delimit the means, and (M - 1,) True for standstill in between."""
    last = len(t) - 1
    boundaries = {0, last, *(k for span in spans for k in (span[0], span[1] - 1))}
    gap_starts = np.flatnonzero(gap)
    boundaries |= {*gap_starts.tolist(), *(gap_starts + 1).tolist()}
    parts = sorted(boundaries)
    edges = [0]
    for a, b in pairwise(parts):
        count = 1 if gap[a] and b == a + 1 else max(1, round((b - a) / width))
        edges += np.linspace(a, b, count + 1).round().astype(int).tolist()[1:]
    indices = np.unique(edges)
    is_stationary = np.zeros(len(t), bool)
    for i, j in spans:
        is_stationary[i : j - 1] = True
    return indices, is_stationary[indices[:-1]]


def _integrate(t: Array, rate: Array) -> Array:
    """Return the (N,) trapezoidal integral, rad."""
    steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(t)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _edge_values(values: Array, edges: NDArray[np.int64]) -> tuple[Array, Array]:
    return values[edges[:-1]], values[edges[1:]]


def _rms_change(axis: VerticalAxis, lag: float) -> float:
    """Return the rms change of the rate within `lag` s, rad/s."""
    shifted = axis.t + lag
    covered = shifted <= axis.t[-1]
    change = np.interp(shifted[covered], axis.t, axis.rate) - axis.rate[covered]
    # If the record is shorter than the lag, use the standard deviation of the rate.
    return float(np.sqrt(np.mean(change**2)) if covered.any() else np.std(axis.rate))
