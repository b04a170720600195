"""The angle of a wheel followed by gravity: how far the model's is off, window by window, then smooth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.gap.problem.problem import NodeData
from hubodo.gap.process_noise.walk import UNKNOWN, scores
from hubodo.gap.process_noise.walk import smoothed as walk_smoothed
from hubodo.model.forward import NodeReading
from hubodo.vehicle import facing_sign

WINDOW = 0.5
_UNWRAP_SPREAD = 0.05
_CLEARLY = 4.0


@dataclass(frozen=True)
class WindowPhases:
    """Middle of each window, s; how far the wheel is ahead of the model, rad, unwrapped; variance, rad²."""

    t: Array
    phase: Array
    variance: Array


def windows(t: Array, width: float = WINDOW) -> NDArray[np.intp]:
    """First sample of each window of `width` s, and the end: (K + 1,) indices; no window is empty."""
    edges = np.searchsorted(t, np.arange(t[0], t[-1], width))
    return np.unique(np.append(edges, len(t)))


def follow(node: NodeData, reading: NodeReading, path: Array | None, accel_noise: float) -> WindowPhases:
    """How far the wheel is ahead of the model's angle, in each window.

    reading: predicted with the wheel further by path, (N,) rad, than the model has it.

    In each window fx + i s fy = offset + e^(-i phase) times what the model predicts, by least squares: the
    offset takes up lever arm, bias and the like, as far as they are expected to go at that spin.
    """
    facing = facing_sign(node.mount.facing or "left")
    measured = node.y[3] + 1j * facing * node.y[4]
    model = reading.accel[0] + 1j * facing * reading.accel[1]
    assert reading.rolling is not None
    edges = windows(node.t)
    total = np.diff(edges).astype(float)

    def summed(value: Array) -> Array:
        return np.asarray(np.add.reduceat(value, edges[:-1]))

    spin = np.sqrt(summed(reading.rolling.spin**2) / total)
    # What may be there without being a turn: m/s².
    allowed = 0.1 + 0.01 * spin**2
    ridge = (accel_noise / allowed) ** 2
    power, mean = summed(np.abs(model) ** 2), summed(model)
    cross, level = summed(measured * model.conj()), summed(measured)
    # Normal equations in (offset, factor), two by two, complex.
    inner = power - np.abs(mean) ** 2 / (total + ridge)
    factor = (cross - level * mean.conj() / (total + ridge)) / np.maximum(inner, 1e-9)
    phase = -np.angle(factor)
    variance = accel_noise**2 / np.maximum(inner * np.maximum(np.abs(factor), 0.05) ** 2, 1e-9)
    middle = summed(node.t) / total
    known = np.zeros(len(total)) if path is None else summed(path) / total
    return WindowPhases(middle, known + _unwrapped(phase, variance), np.maximum(variance, 1e-8))


def _unwrapped(phase: Array, variance: Array) -> Array:
    """Turns added so that neighbours agree with the trend of the windows before them."""
    made = np.empty_like(phase)
    slope, last, gap = 0.0, phase[0], 0
    for k, value in enumerate(phase):
        expected = last + slope * (gap + 1)
        value = expected + (value - expected + np.pi) % (2.0 * np.pi) - np.pi
        if variance[k] > _UNWRAP_SPREAD:
            made[k], gap = expected, gap + 1
            continue
        if k:
            slope += 0.5 * ((value - last) / (gap + 1) - slope)
        made[k], last, gap = value, value, 0
    return made


def smoothed(phases: WindowPhases, walk: float) -> tuple[Array, float]:
    """The path through the windows, (K,) rad, and the walk, rad²/s, that they ask for, at least `walk`.

    The intensity is the one that makes the innovations most likely.
    """
    steps = np.diff(phases.t)
    grid = walk * np.geomspace(1.0, 1e10, 21)
    tried = scores(phases.phase, phases.variance, steps, grid, np.full_like(grid, UNKNOWN))
    at = int(np.argmax(tried))
    # The declared walk is believed unless another is clearly likelier.
    if tried[at] <= tried[0] + _CLEARLY:
        at = 0
    likeliest = float(grid[at])
    return walk_smoothed(phases.phase, phases.variance, steps, likeliest), likeliest


def on_samples(node: NodeData, phases: WindowPhases, path: Array) -> Array:
    """The path between the windows' middles, (N,) rad."""
    return np.interp(node.t, phases.t, path)
