"""Effects added to the samples of a real recording, written without the forward model that `gap` uses.

Each function changes the table of one node as a worse sensor, clock or mounting would have changed it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hubodo.recording import Recording, Table

Array = NDArray[np.float64]
GYRO, ACCEL = ("gx", "gy", "gz"), ("ax", "ay", "az")


@dataclass(frozen=True)
class Injection:
    """One effect of known size in the samples of one node.

    effect, parameters: as `hubodo gap` should name them; values in SI units
    strength: medium or strong
    change: function from the (7, N) rows t, gyro, accel to changed rows
    """

    effect: str
    strength: str
    parameters: Mapping[str, float]
    change: Callable[[Array, np.random.Generator], Array]

    def apply(self, recording: Recording, node: str, seed: int) -> Recording:
        """Return a copy of the recording in which one node has the effect."""
        table = recording.nodes[node]
        rows = np.stack([table.t, *(table[name] for name in (*GYRO, *ACCEL))])
        changed = self.change(rows.copy(), np.random.default_rng(seed))
        order = np.concatenate([[True], np.diff(changed[0]) > 0.0])
        columns = dict(zip(("t", *GYRO, *ACCEL), changed[:, order], strict=True))
        return replace(recording, nodes={**recording.nodes, node: Table(columns)})


def _offset(axes: Mapping[int, float]) -> Callable[[Array, np.random.Generator], Array]:
    def change(rows: Array, rng: np.random.Generator) -> Array:
        for row, value in axes.items():
            rows[1 + row] += value
        return rows

    return change


def _scale(axes: Mapping[int, float]) -> Callable[[Array, np.random.Generator], Array]:
    def change(rows: Array, rng: np.random.Generator) -> Array:
        for row, error in axes.items():
            rows[1 + row] *= 1.0 + error
        return rows

    return change


def _cubic(c: float) -> Callable[[Array, np.random.Generator], Array]:
    def change(rows: Array, rng: np.random.Generator) -> Array:
        rows[3] += c * rows[3] ** 3
        return rows

    return change


def _lag(tau: float) -> Callable[[Array, np.random.Generator], Array]:
    """Return a one-pole low-pass, exact for a signal that is linear between samples."""

    def change(rows: Array, rng: np.random.Generator) -> Array:
        t, rate = rows[0], rows[1:4].copy()
        slow = rate[:, 0].copy()
        for k in range(1, len(t)):
            dt = t[k] - t[k - 1]
            decay, slope = np.exp(-dt / tau), (rate[:, k] - rate[:, k - 1]) / dt
            slow = rate[:, k] - tau * slope + (slow - rate[:, k - 1] + tau * slope) * decay
            rows[1:4, k] = slow
        return rows

    return change


def _rotation(x: float, y: float, z: float) -> Array:
    """Return the matrix that turns vectors by this rotation vector (Rodrigues)."""
    angle = float(np.sqrt(x * x + y * y + z * z))
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) / angle
    return np.asarray(np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * k @ k)


def _misalignment(x: float, y: float, z: float) -> Callable[[Array, np.random.Generator], Array]:
    """Return readings in axes turned by this rotation vector: each vector appears turned the other way."""

    def change(rows: Array, rng: np.random.Generator) -> Array:
        back = _rotation(x, y, z).T
        rows[1:4], rows[4:7] = back @ rows[1:4], back @ rows[4:7]
        return rows

    return change


def _skewed_axes(
    xz: float, xy: float, yz: float, yx: float, zy: float, zx: float, first: int
) -> Callable[[Array, np.random.Generator], Array]:
    """Return readings with Avrutov's cross-axis errors, rows x [0, xz, -xy], [-yz, 0, yx], [zy, -zx, 0]."""

    def change(rows: Array, rng: np.random.Generator) -> Array:
        n = np.array([[0.0, xz, -xy], [-yz, 0.0, yx], [zy, -zx, 0.0]])
        rows[first : first + 3] += n @ rows[first : first + 3]
        return rows

    return change


def _g_sensitivity(x: float, y: float, z: float) -> Callable[[Array, np.random.Generator], Array]:
    def change(rows: Array, rng: np.random.Generator) -> Array:
        rows[3] += x * rows[4] + y * rows[5] + z * rows[6]
        return rows

    return change


def _warmup(z: float, time_constant: float) -> Callable[[Array, np.random.Generator], Array]:
    def change(rows: Array, rng: np.random.Generator) -> Array:
        rows[3] += z * (1.0 - np.exp(-(rows[0] - rows[0, 0]) / time_constant))
        return rows

    return change


def _walk(k: float) -> Callable[[Array, np.random.Generator], Array]:
    def change(rows: Array, rng: np.random.Generator) -> Array:
        steps = np.sqrt(np.diff(rows[0], prepend=rows[0, 0]))
        rows[1:4] += np.cumsum(k * steps * rng.standard_normal((3, len(steps))), axis=1)
        return rows

    return change


def _clip(first: int, limit: float) -> Callable[[Array, np.random.Generator], Array]:
    def change(rows: Array, rng: np.random.Generator) -> Array:
        rows[first : first + 3] = np.clip(rows[first : first + 3], -limit, limit)
        return rows

    return change


def _round(step: float) -> Callable[[Array, np.random.Generator], Array]:
    def change(rows: Array, rng: np.random.Generator) -> Array:
        rows[1:4] = step * np.round(rows[1:4] / step)
        return rows

    return change


def _repeat(probability: float) -> Callable[[Array, np.random.Generator], Array]:
    def change(rows: Array, rng: np.random.Generator) -> Array:
        for k in np.flatnonzero(rng.random(rows.shape[1]) < probability):
            if k:
                rows[1:, k] = rows[1:, k - 1]
        return rows

    return change


def _spikes(
    probability: float, gyro_sigma: float, accel_sigma: float
) -> Callable[[Array, np.random.Generator], Array]:
    """Return Gaussian spikes with 1 sigma `gyro_sigma` and `accel_sigma` in each channel."""

    def change(rows: Array, rng: np.random.Generator) -> Array:
        hit = rng.random((6, rows.shape[1])) < probability
        spike = rng.normal(size=hit.shape) * np.array([gyro_sigma] * 3 + [accel_sigma] * 3)[:, None]
        rows[1:] += hit * spike
        return rows

    return change


def _late(delay: float) -> Callable[[Array, np.random.Generator], Array]:
    def change(rows: Array, rng: np.random.Generator) -> Array:
        rows[0] += delay
        return rows

    return change


def _skew(ppm: float) -> Callable[[Array, np.random.Generator], Array]:
    def change(rows: Array, rng: np.random.Generator) -> Array:
        rows[0] = rows[0, 0] + (rows[0] - rows[0, 0]) * (1.0 + ppm * 1e-6)
        return rows

    return change


def _lever_arm(x: float, y: float, z: float) -> Callable[[Array, np.random.Generator], Array]:
    """Return the rigid-body acceleration of a point off the sensor, by its own gyro, over five samples."""

    def change(rows: Array, rng: np.random.Generator) -> Array:
        kernel = np.ones(5) / 5.0
        rate = np.stack([np.convolve(np.pad(row, 2, "edge"), kernel, "valid") for row in rows[1:4]])
        growth = np.gradient(rate, rows[0], axis=1)
        arm = np.array([x, y, z])
        inner = np.cross(rate.T, arm)
        rows[4:7] += (np.cross(growth.T, arm) + np.cross(rate.T, inner)).T
        return rows

    return change


def injections(top_rate: float, gyro_noise: float, accel_noise: float) -> list[Injection]:
    """Return the effects, medium and strong.

    top_rate: largest spin rate of the drive, rad/s, for saturation; gyro_noise, accel_noise: declared noise
    """
    cases: list[Injection] = []
    for strength, k in (("medium", 1.0), ("strong", 2.0)):
        add = lambda effect, change, strength=strength, **parameters: cases.append(  # noqa: E731
            Injection(effect, strength, parameters, change)
        )
        add("gyro_bias", _offset({0: 0.02 * k, 1: -0.015 * k}), x=0.02 * k, y=-0.015 * k)
        add("gyro_scale_factor", _scale({2: 0.01 * k}), z=0.01 * k)
        add("gyro_cubic", _cubic(1e-5 * k), z=1e-5 * k)
        add("gyro_lag", _lag(0.01 * k), time_constant=0.01 * k)
        add("node_misalignment", _misalignment(0.03 * k, -0.02 * k, 0.0), x=0.03 * k, y=-0.02 * k)
        add(
            "gyro_nonorthogonality",
            _skewed_axes(0.0, 0.01 * k, 0.0, -0.01 * k, 0.0, 0.0, 1),
            xy=0.01 * k,
            yx=-0.01 * k,
        )
        add("gyro_g_sensitivity", _g_sensitivity(0.002 * k, 0.0, 0.001 * k), x=0.002 * k)
        add("gyro_warmup", _warmup(0.03 * k, 30.0), z=0.03 * k, time_constant=30.0)
        add("gyro_rate_random_walk", _walk(0.003 * k), k=0.003 * k)
        add("gyro_saturation", _clip(1, top_rate * (1.0 - 0.08 * k)), limit=top_rate * (1.0 - 0.08 * k))
        add("gyro_quantization", _round(0.1 * k), step=0.1 * k)
        add("sample_repeat", _repeat(0.04 * k), probability=0.04 * k)
        add(
            "outliers",
            _spikes(0.01, 15.0 * k * gyro_noise, 15.0 * k * accel_noise),
            probability=0.01,
            sigma=15.0 * k,
        )
        add("time_offset", _late(0.02 * k), delay=0.02 * k)
        add("clock_skew", _skew(800.0 * k), ppm=800.0 * k)
        add("lever_arm", _lever_arm(0.015 * k, 0.01 * k, 0.0), x=0.015 * k, y=0.01 * k)
        add("accel_bias", _offset({3: 0.3 * k, 4: 0.2 * k}), x=0.3 * k, y=0.2 * k)
        add("accel_scale_factor", _scale({3: 0.02 * k, 4: 0.02 * k}), x=0.02 * k, y=0.02 * k)
        add("accel_saturation", _clip(4, 15.0 - 2.0 * k), limit=15.0 - 2.0 * k)
    return cases
