"""A recording of one gyro axis to its heading, with what simpler ways would have made of it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.effects.warmup import WarmupModel
from hubodo.fuse.heading_filter import BiasNoise, HeadingFilter
from hubodo.sensors.heading.standstill import Spans

_GAP_STEPS = 5.0


@dataclass(frozen=True)
class Axis:
    """One gyro axis that stands upright.

    t: (N,) s. rate: (N,) rad/s, anticlockwise seen from above, calibrated but for warm-up and the bias of the
    day. raw: (N,) rad/s, the same as it was recorded. temperature: (N,) degrees C or None.
    """

    t: Array
    rate: Array
    raw: Array
    temperature: Array | None = None


@dataclass(frozen=True)
class HeadingTrack:
    """Heading at M times, in rad from that of the first sample, anticlockwise seen from above.

    t: (M,) s. heading, sigma: (M,) rad. bias, sigma_bias: (M,) rad/s of the axis, warm-up included.
    rivals: by name, (M,) rad: the rate integrated as it is, and less its mean in the first standstill.
    gaps: s, those in which samples are missing.
    """

    t: Array
    heading: Array
    sigma: Array
    bias: Array
    sigma_bias: Array
    rivals: dict[str, Array]
    gaps: tuple[tuple[float, float], ...]


def heading_track(
    axis: Axis,
    spans: Spans,
    model: WarmupModel,
    noise: BiasNoise,
    *,
    age: float = 0.0,
    scale_sigma: float = 0.0,
    lag: float = 0.0,
    step: float = 0.1,
) -> HeadingTrack:
    """Run the filter over means of about `step` s, in which the axis rests or does not.

    spans: standstills. model: of the axis as it stands in `axis`. age: s since power-on at the first sample.
    scale_sigma: 1 sigma of the relative scale: a constant, so its error is that of the net turn. lag: s by
    which the gyro may answer late: the heading is behind by that times its rate. In a gap the rate is a
    straight line between its ends, wrong by what it elsewhere changes within half that time.
    """
    t = axis.t
    typical = float(np.median(np.diff(t)))
    gap = np.diff(t) > _GAP_STEPS * typical
    edges, at_rest = _edges(t, spans, gap, max(1, round(step / typical)))
    turned = _integral(t, axis.rate)
    lengths, turns = np.diff(t[edges]), np.diff(turned[edges])
    middle = None if axis.temperature is None else 0.5 * np.add(*_ends(axis.temperature, edges))
    filter_ = HeadingFilter(model, noise, age=age)
    rows = [(0.0, 0.0, model.c2, noise.offset)]
    for k, (dt, turn, rest) in enumerate(zip(lengths.tolist(), turns.tolist(), at_rest, strict=True)):
        doubt = _within(axis, 0.5 * dt) if gap[edges[k]] and edges[k + 1] == edges[k] + 1 else 0.0
        grade = None if middle is None else float(middle[k])
        filter_.update(turn / dt, dt, is_stationary=bool(rest), temperature=grade, sigma=doubt)
        state = filter_.state()
        rows.append((float(state.heading), state.sigma_heading, float(state.bias), state.sigma_bias))
    heading, sigma, bias, sigma_bias = np.array(rows).T
    raw = _integral(t, axis.raw)
    rivals = {"integrated as it is": raw[edges]}
    if spans:
        first = float(axis.raw[slice(*spans[0])].mean())
        rivals["less the mean of the first standstill"] = (raw - first * (t - t[0]))[edges]
    return HeadingTrack(
        t[edges],
        heading,
        np.sqrt(sigma**2 + (scale_sigma * heading) ** 2 + (lag * _gained(t[edges], turned[edges])) ** 2),
        bias,
        sigma_bias,
        rivals,
        tuple((float(t[k]), float(t[k + 1])) for k in np.flatnonzero(gap)),
    )


def _gained(t: Array, turned: Array) -> Array:
    """(M,) rad/s by which each rate differs from the first."""
    rates = np.gradient(turned, t)
    return np.asarray(rates - rates[0])


def _edges(
    t: Array, spans: Spans, gap: NDArray[np.bool_], width: int
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """(M,) samples at which means begin and end, and (M - 1,) whether the axis rests between them."""
    last = len(t) - 1
    marks = {0, last, *(k for span in spans for k in (span[0], span[1] - 1))}
    holes = np.flatnonzero(gap)
    marks |= {*holes.tolist(), *(holes + 1).tolist()}
    parts = sorted(marks)
    edges = [0]
    for a, b in pairwise(parts):
        count = 1 if gap[a] and b == a + 1 else max(1, round((b - a) / width))
        edges += np.linspace(a, b, count + 1).round().astype(int).tolist()[1:]
    made = np.unique(edges)
    rest = np.zeros(len(t), bool)
    for i, j in spans:
        rest[i : j - 1] = True
    return made, rest[made[:-1]]


def _integral(t: Array, rate: Array) -> Array:
    """(N,) rad, of straight lines between the samples."""
    steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(t)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _ends(values: Array, edges: NDArray[np.int64]) -> tuple[Array, Array]:
    return values[edges[:-1]], values[edges[1:]]


def _within(axis: Axis, lag: float) -> float:
    """rad/s, rms by which the rate changes within `lag` s."""
    later = axis.t + lag
    inside = later <= axis.t[-1]
    change = np.interp(later[inside], axis.t, axis.rate) - axis.rate[inside]
    # With no such time left in the record the whole scatter of the rate stands for it.
    return float(np.sqrt(np.mean(change**2)) if inside.any() else np.std(axis.rate))
