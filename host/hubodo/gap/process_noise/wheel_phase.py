"""Wheel angle from the direction of gravity: phase offset to the model per window, then smoothed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.gap.problem.problem import NodeData
from hubodo.gap.process_noise.walk_likelihood import DIFFUSE_VARIANCE, walk_log_likelihoods
from hubodo.gap.process_noise.walk_likelihood import smooth_walk as walk_smoothed
from hubodo.model.forward import NodeReading
from hubodo.vehicle import facing_sign

# s
WINDOW_DURATION = 0.5
# rad²; phases with more are not used for unwrapping.
_MAX_UNWRAP_VARIANCE = 0.05
# Smallest gain of ln likelihood of a walk over the declared one.
_MIN_WALK_GAIN = 4.0
# Singular value of the normalised trends below which they count as linearly dependent.
_MIN_TREND_SIZE = 0.01


@dataclass(frozen=True)
class WindowPhases:
    """Phase offsets of a wheel per window.

    t: s, centre of the window
    phase: rad, measured minus modelled wheel angle, unwrapped
    variance: rad²
    wheel_angle, heading: rad, of the model, means of the window
    """

    t: Array
    phase: Array
    variance: Array
    wheel_angle: Array
    heading: Array


def window_boundaries(t: Array, width: float = WINDOW_DURATION) -> NDArray[np.intp]:
    """Return the first sample of each window of `width` s, and the end, (K + 1,); no window is empty."""
    edges = np.searchsorted(t, np.arange(t[0], t[-1], width))
    return np.unique(np.append(edges, len(t)))


def estimate_phases(
    node: NodeData, reading: NodeReading, phase_offset: Array | None, accel_sigma: float
) -> WindowPhases:
    """Estimate the angle by which the wheel leads the model in each window.

    reading: predicted with `phase_offset`, (N,) rad, added to the wheel angle
    accel_sigma: m/s²

    Least squares of fx + i s fy = offset + e^(-i phase) · prediction in each window, s: facing sign. The
    offset absorbs lever arm and bias, up to their usual size at that spin.
    """
    facing = facing_sign(node.mount.facing or "left")
    measured = node.y[3] + 1j * facing * node.y[4]
    model = reading.accel[0] + 1j * facing * reading.accel[1]
    assert reading.rolling is not None
    edges = window_boundaries(node.t)
    total = np.diff(edges).astype(float)

    def summed(value: Array) -> Array:
        return np.asarray(np.add.reduceat(value, edges[:-1]))

    spin = np.sqrt(summed(reading.rolling.spin**2) / total)
    # Usual size of the offset, m/s².
    usual_offset = 0.1 + 0.01 * spin**2
    ridge = (accel_sigma / usual_offset) ** 2
    power, mean = summed(np.abs(model) ** 2), summed(model)
    cross, level = summed(measured * model.conj()), summed(measured)
    # Normal equations in (offset, factor), two by two, complex.
    information = power - np.abs(mean) ** 2 / (total + ridge)
    factor = (cross - level * mean.conj() / (total + ridge)) / np.maximum(information, 1e-9)
    phase = -np.angle(factor)
    variance = accel_sigma**2 / np.maximum(information * np.maximum(np.abs(factor), 0.05) ** 2, 1e-9)
    middle = summed(node.t) / total
    previous = np.zeros(len(total)) if phase_offset is None else summed(phase_offset) / total
    return WindowPhases(
        middle,
        previous + _unwrap(phase, variance),
        np.maximum(variance, 1e-8),
        summed(reading.rolling.angle) / total,
        summed(reading.body.heading) / total,
    )


def _unwrap(phase: Array, variance: Array) -> Array:
    """Unwrap phases to follow the trend of the preceding windows."""
    unwrapped = np.empty_like(phase)
    slope, last, gap = 0.0, phase[0], 0
    for k, value in enumerate(phase):
        expected = last + slope * (gap + 1)
        value = expected + (value - expected + np.pi) % (2.0 * np.pi) - np.pi
        if variance[k] > _MAX_UNWRAP_VARIANCE:
            unwrapped[k], gap = expected, gap + 1
            continue
        if k:
            slope += 0.5 * ((value - last) / (gap + 1) - slope)
        unwrapped[k], last, gap = value, value, 0
    return unwrapped


def smooth_phases(phases: WindowPhases, walk: float, is_steady: bool = False) -> tuple[Array, float]:
    """Return the smoothed phase offset, (K,) rad, and the intensity of its walk, rad²/s.

    The intensity is the most likely one, at least `walk`.
    is_steady: True to separate trends of the phase with wheel angle, time and heading, which a wrong radius,
        bias or track width causes, from the walk. They remain in the smoothed offset, where an effect that
        explains them gains.
    """
    steps = np.diff(phases.t)
    trends = _trends(phases) if is_steady else None
    grid = walk * np.geomspace(1.0, 1e10, 21)
    likelihoods = walk_log_likelihoods(
        phases.phase,
        phases.variance,
        steps,
        grid,
        np.full_like(grid, DIFFUSE_VARIANCE),
        trends,
    )
    best = int(np.argmax(likelihoods))
    # The declared walk is kept unless another is clearly more likely.
    if likelihoods[best] <= likelihoods[0] + _MIN_WALK_GAIN:
        best = 0
    likeliest = float(grid[best])
    smoothed = walk_smoothed(phases.phase, phases.variance, steps, likeliest, DIFFUSE_VARIANCE, trends)
    return smoothed, likeliest


def _trends(phases: WindowPhases) -> Array:
    """Return the trends that a phase may have, (M, K), as orthonormal curves without mean."""
    curves = np.stack([phases.t, phases.wheel_angle, phases.heading])
    centred = curves - curves.mean(axis=1, keepdims=True)
    scale = np.sqrt((centred**2).sum(axis=1, keepdims=True))
    shapes = centred[scale[:, 0] > 1e-9] / scale[scale[:, 0] > 1e-9]
    _, sizes, directions = np.linalg.svd(shapes, full_matrices=False)
    return np.asarray(directions[sizes > _MIN_TREND_SIZE])


def interpolate_phases(node: NodeData, phases: WindowPhases, offsets: Array) -> Array:
    """Interpolate phase offsets between the centres of the windows, (N,) rad."""
    return np.interp(node.t, phases.t, offsets)
