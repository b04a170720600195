"""Noise of simulated nodes from the residuals of real drives, resampled in blocks of a few seconds.

A block of a simulated drive gets the samples of a section of the real drive with a similar course of the spin
rate, standstill included. Samples stay in order, so that the spectrum per sample and the harmonics of the
spin are preserved.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from gap_matrix.effects import SIDES
from hubodo.gap.explain.missing_effects import MissingEffects
from hubodo.recording import Recording

Array = NDArray[np.float64]

BLOCK_S = 3.0
# Points of a block at which spin rates are compared, and spacing of the candidates in the real drive.
_PROFILE_POINTS, _CANDIDATE_STEP_S = 6, 0.25
# A block is drawn from all candidates whose spin rates differ by less than this share, and at least from the
# nearest few.
_MAX_SPIN_DIFFERENCE, _MIN_CANDIDATES = 0.1, 8
_N_SPIN_PARTS = 10
# Hz; the body of a car does not rotate faster, so higher frequencies are vibration and noise.
_BODY_BAND_HZ = 2.0
# Axis along which the z axes of the real nodes point: outwards on both sides.
REAL_FACING = {"left": "left", "right": "right"}


@dataclass(frozen=True)
class NodeResidual:
    """Residual of one real node.

    spin: (N,) rad/s, magnitude
    value: (N, 6) measured minus predicted, gyro and accelerometer relative to their rms on the whole drive
    rate_hz: sample rate
    """

    spin: Array
    value: Array
    rate_hz: float

    @cached_property
    def _candidates(self) -> tuple[NDArray[np.intp], Array]:
        """Return the first samples of all stretches, and the square root of their spin rates per sample."""
        length = round(BLOCK_S * self.rate_hz)
        starts = np.arange(0, len(self.spin) - length, round(_CANDIDATE_STEP_S * self.rate_hz))
        points = np.linspace(0, length - 1, _PROFILE_POINTS).astype(int)
        return starts, np.sqrt(self.spin[starts[:, None] + points] / self.rate_hz)

    def resample(self, spin: Array, rate_hz: float, rng: np.random.Generator) -> Array:
        """Return noise, (n, 6), for samples at these spin rates, (n,) rad/s.

        The square root gives a standstill and slow driving the weight that their small noise deserves.
        """
        starts, profiles = self._candidates
        length, noise = round(BLOCK_S * self.rate_hz), np.empty((len(spin), 6))
        for first in range(0, len(spin), length):
            inside = np.clip(first + np.linspace(0, length - 1, _PROFILE_POINTS), 0, len(spin) - 1)
            profile = np.sqrt(np.abs(spin[inside.astype(int)]) / rate_hz)
            distance = np.sum((profiles - profile) ** 2, axis=1)
            # A relative difference of the spin is twice that of its square root.
            near = np.sum((0.5 * _MAX_SPIN_DIFFERENCE * profile) ** 2)
            count_near = max(_MIN_CANDIDATES, int(np.sum(distance <= near)))
            start = starts[rng.choice(np.argsort(distance, kind="stable")[:count_near])]
            count = min(length, len(spin) - first)
            noise[first : first + count] = self.value[start : start + count]
        return noise

    def sigma(self, spin: Array, rate_hz: float) -> Array:
        """Return the rms of the noise, (n, 6), at these spin rates, (n,) rad/s."""
        return np.sqrt(average_by_spin(self.spin / self.rate_hz, self.value**2, np.abs(spin) / rate_hz))


@dataclass(frozen=True)
class DriveNoise:
    """Residuals of one real drive: those of its wheel nodes, and (N, 6) of the body node, x forward."""

    name: str
    nodes: Mapping[str, NodeResidual]
    body: NodeResidual

    def save(self, path: Path) -> None:
        """Write the residuals to a file."""
        columns = {
            f"{name}.{key}": value
            for name, node in {**self.nodes, "body": self.body}.items()
            for key, value in (("spin", node.spin), ("value", node.value), ("rate", node.rate_hz))
        }
        np.savez_compressed(path, **columns)


def load_noise(path: Path) -> DriveNoise:
    """Read the residuals of a drive."""
    with np.load(path) as stored:
        nodes = {
            name: NodeResidual(stored[f"{name}.spin"], stored[f"{name}.value"], float(stored[f"{name}.rate"]))
            for name in (*SIDES, "body")
        }
    return DriveNoise(path.stem, {side: nodes[side] for side in SIDES}, nodes["body"])


def extract_noise(name: str, recording: Recording, result: MissingEffects) -> DriveNoise:
    """Return the residuals of a drive beside the model that was learnt on it.

    Residuals are centred at each spin rate: a mean that persists is an effect that the learnt model lacks,
    and no noise. The speed is the mean of both gyros along the axles: their residuals show only half of the
    variance, and the other half is the noise of the speed.
    """
    values, scales = {}, np.zeros(2)
    for side in SIDES:
        residual = result.residual_steps[-1][side]
        spin = np.abs(residual.node.y[2])
        value = residual.value.T - average_by_spin(spin, residual.value.T, spin)
        value[:, 2] *= np.sqrt(2.0)
        values[side] = (spin, value, _sample_rate(residual.node.t))
        scales += np.mean(value[:, :3] ** 2), np.mean(value[:, 3:] ** 2)
    scale = np.repeat(np.sqrt(scales / len(SIDES)), 3)
    nodes = {side: NodeResidual(spin, value / scale, rate) for side, (spin, value, rate) in values.items()}
    left = recording.nodes["left"]
    spin = np.abs(np.interp(recording.nodes["frame"].t, left.t, left["gz"]))
    return DriveNoise(name, nodes, _body_noise(recording, spin, scale))


def _body_noise(recording: Recording, spin: Array, scale: Array) -> NodeResidual:
    """Return the vibration and noise of the node on the body.

    Its axes right, forward, up become forward, left, up.
    """
    table = recording.nodes["frame"]
    rate = _sample_rate(table.t)
    readings = np.stack([table[name] for name in ("gy", "gx", "gz", "ay", "ax", "az")], axis=1)
    readings[:, [1, 4]] *= -1.0
    fast = sosfiltfilt(butter(2, _BODY_BAND_HZ, "high", fs=rate, output="sos"), readings, axis=0)
    return NodeResidual(spin, fast / scale, rate)


def average_by_spin(spin: Array, values: Array, at: Array) -> Array:
    """Return the mean of values, (N, 6), at other spin rates, (n,).

    Interpolated between the means of tenths of the samples.
    """
    parts = np.array_split(np.argsort(spin, kind="stable"), _N_SPIN_PARTS)
    centres = np.array([np.mean(spin[part]) for part in parts])
    means = np.array([np.mean(values[part], axis=0) for part in parts])
    return np.stack([np.interp(at, centres, column) for column in means.T], axis=1)


def _sample_rate(t: Array) -> float:
    return float((len(t) - 1) / np.ptp(t))


def turn_over(noise: Array) -> Array:
    """Return noise, (n, 6), of a node that is rotated by 180° about x, so that z points to the other side."""
    return noise * np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])
