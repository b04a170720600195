"""Random walk of the bias that the standstills of a heading record show, as a changing temperature causes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from hubodo.arrays import Array
from hubodo.effects.warmup import WarmupModel, warmup_fraction
from hubodo.fuse.heading_filter import BiasNoise
from hubodo.sensors.heading.vertical_axis import Spans, VerticalAxis
from hubodo.sensors.north.drift import DriftNoise, drift_covariance, random_walk_covariance

TYPICAL_TEMPERATURE_COEFFICIENT = math.radians(0.02)  # rad/s per °C
"""Data sheets of MEMS gyros state 0.005 to 0.05 deg/s per °C."""
_BLOCK_S, _MAX_BLOCKS = 10.0, 6
"""Length of the means within a standstill, and their largest number in one."""
_MIN_LOG_LIKELIHOOD_GAIN = 4.5
"""Gain of the logarithm of the likelihood that chance gives to a walk in one of 700 records."""
_WALKS = np.radians(np.logspace(-4.0, -1.0, 31))  # rad/s/√s


def add_bias_walk(
    noise: BiasNoise, model: WarmupModel, axis: VerticalAxis, spans: Spans, age: float, notes: list[str]
) -> BiasNoise:
    """Return the noise with the random walk that the standstills show beyond it.

    model: warm-up of the axis. age: s since power-on at the first sample. Where the temperature is not
    measured, a remark gives the heading error that its change between standstills would cause.
    """
    t = axis.t - axis.t[0] + age
    residual = np.asarray(axis.rate - model.bias(t, axis.temperature))
    walk = _estimate_walk(
        axis.t, residual, spans, noise, list(_known_changes(noise, model, t, axis.temperature))
    )
    if walk > noise.rate_random_walk:
        notes.append(
            "the bias at standstill changes more than noise and bias instability explain, as with the "
            "temperature or after power-on: sigma includes a random walk of "
            f"{math.degrees(walk):.2g} deg/s/√s"
        )
        return replace(noise, rate_random_walk=walk)
    moving = _longest_motion(axis.t, spans)
    if axis.temperature is None and moving > 0.0:
        coefficient = math.degrees(TYPICAL_TEMPERATURE_COEFFICIENT)
        notes.append(
            "without a thermometer the bias is assumed to be stable while the sensor moves, up to "
            f"{moving:.0f} s: 1 °C for all of that time, typically {coefficient:.2g} deg/s, turns the "
            f"heading by {coefficient * moving:.2g} degrees, which sigma does not include; log the "
            "temperature, or stop more often"
        )
    return noise


def _known_changes(
    noise: BiasNoise, model: WarmupModel, t: Array, temperature: Array | None
) -> Iterator[Array]:
    """Yield the (N,) changes of the bias by the uncertain parameters that the filter estimates, 1σ each."""
    for suffix, constant in (("", model.time_constant), ("_second", model.time_constant_second)):
        if sigma := noise.warmup.get(f"c1{suffix}"):
            yield sigma * warmup_fraction(t, constant)
    if temperature is not None and (sigma := noise.warmup.get("temperature_coefficient")):
        yield sigma * (temperature - temperature.mean())


def _longest_motion(t: Array, spans: Spans) -> float:
    """Return the longest time without a standstill, s."""
    edges = [t[0], *(float(t[k]) for i, j in spans for k in (i, j - 1)), t[-1]]
    return float(max(b - a for a, b in zip(edges[::2], edges[1::2], strict=True)))


def _estimate_walk(
    t: Array, residual: Array, spans: Spans, noise: BiasNoise, known: Sequence[Array]
) -> float:
    """Return K of the random walk, rad/s/√s, by which the bias changes more than its noise; 0 if it does not.

    t: (N,) s. residual: (N,) rate less the modelled bias, rad/s. noise: N and B of the gyro. known: (N,)
    changes of the bias that the filter estimates by itself, one standard deviation of each. The size of the
    walk maximises the restricted likelihood of means within the standstills, whose common level is unknown.
    """
    edges = [
        edge
        for i, j in spans
        for edge in np.array_split(
            np.arange(i, j), int(np.clip((t[j - 1] - t[i]) / _BLOCK_S, 1, _MAX_BLOCKS))
        )
        if len(edge) > 1
    ]
    if len(edges) < 2:
        return 0.0
    start, end = t[[block[0] for block in edges]], t[[block[-1] for block in edges]]
    means = np.array([residual[block].mean() for block in edges])
    fixed = drift_covariance(DriftNoise(noise.angle_random_walk, noise.bias_instability, 0.0), start, end)
    for change in known:
        column = [change[block].mean() for block in edges]
        fixed = fixed + np.outer(column, column)
    walk = random_walk_covariance(start, end)
    gains = np.array([_log_likelihood(fixed + k**2 * walk, means) for k in (0.0, *_WALKS)])
    best = int(np.argmax(gains))
    return float(_WALKS[best - 1]) if gains[best] - gains[0] > _MIN_LOG_LIKELIHOOD_GAIN else 0.0


def _log_likelihood(covariance: Array, means: Array) -> float:
    """Return the restricted log-likelihood of means (M,) with an unknown common level."""
    root = np.linalg.cholesky(covariance)
    ones, y = np.linalg.solve(root, np.ones(len(means))), np.linalg.solve(root, means)
    residual = y - ones * (ones @ y) / (ones @ ones)
    return float(-np.log(np.diag(root)).sum() - math.log(ones @ ones) / 2 - residual @ residual / 2)
