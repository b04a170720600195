"""Car drives with an engine that idles at standstill, at the start and in the middle of the drive.

The engine's forces are sums of sines at half, one and two times its firing frequency, whose speed fluctuates
by 0.3 to 2 %; they shake the hub along all axes and rotate it to and fro. The chip samples them behind a
filter of finite steepness, so frequencies beyond half of the sample rate are aliased.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import butter, lfilter

from generators import wheel_drives

_RATES_HZ = (50.0, 104.0, 120.0, 208.0, 416.0)
_ORDERS = ((0.5, 0.3), (1.0, 1.0), (2.0, 0.5))
"""Multiples of the firing frequency, and their share of the amplitude."""

_MAX_ROUGH_SHARE, _ROCKING_HZ = 1.0, (1.0, 12.0)
"""Largest share of the amplitude, and the band in Hz, of the rocking by uneven firing."""

_GYRO_SHARE = 0.02
"""(rad/s)/(m/s²) of rotation beside the shaking: 1 m/s² at 25 Hz on an arm of 0.3 m."""


@dataclass(frozen=True)
class Idle:
    """An engine: rpm, shaking in m/s² rms of all axes together, sample rate, and relative hunting."""

    rpm: float
    shaking: float
    rate_hz: float
    hunting: float

    def __str__(self) -> str:
        rpm = f"{self.rpm:.0f} rpm, hunts by {100 * self.hunting:g} %"
        return f"{rpm}, {self.shaking:.1f} m/s², {self.rate_hz:.0f} Hz"


def idling_drive(seed: int) -> tuple[Idle, wheel_drives.WheelDrive]:
    """Return the drive of a seed: twice 13 s idling and half a minute of driving."""
    rng = np.random.default_rng(seed)
    rate_hz, shaking = float(rng.choice(_RATES_HZ)), float(np.exp(rng.uniform(np.log(0.5), np.log(5.0))))
    rpm, hunting = float(rng.uniform(600.0, 3000.0)), float(rng.choice([0.003, 0.02]))
    if seed % 2 and rate_hz < 200.0:
        # An order near the sample rate is aliased to a force that hardly changes.
        orders = [order for order, _ in _ORDERS if 600.0 <= 30.0 * rate_hz / order <= 3000.0]
        rpm = 30.0 * (rate_hz + float(rng.uniform(-0.3, 0.3))) / float(rng.choice(orders))
    idle = Idle(rpm, shaking, rate_hz, hunting)
    parts = []
    for _ in range(2):
        parts.append((13.0, 0.0, 0.0))
        parts += [(8.0, float(rng.uniform(3.0, 9.0)), float(rng.uniform(-0.25, 0.25))) for _ in range(4)]
    parts.append((6.0, 0.0, 0.0))
    plan = wheel_drives.ramps(parts)
    driven = wheel_drives.drive(plan, rng, wheel_drives.Errors(vibration=0.3), 0.3, 1.4, rate_hz=idle.rate_hz)
    nodes = {name: _shake(node, driven, idle, rng) for name, node in driven.nodes.items()}
    return idle, replace(driven, nodes=nodes)


def _rocking(t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return noise of unit size between 1 and 12 Hz: uneven firing rocks the body on its springs."""
    numerator, denominator = butter(2, _ROCKING_HZ, "bandpass", fs=1.0 / float(np.median(np.diff(t))))
    noise = lfilter(numerator, denominator, rng.standard_normal(len(t)))
    return np.asarray(noise / noise.std())


def _shake(
    node: wheel_drives.Node, driven: wheel_drives.WheelDrive, idle: Idle, rng: np.random.Generator
) -> wheel_drives.Node:
    """Return the node with the engine's shaking while the car stands."""
    t = node.t
    hunting = 1.0 + idle.hunting * np.sin(2.0 * np.pi * 0.4 * t + rng.uniform(0.0, 6.28))
    turns = np.cumsum(hunting * np.gradient(t)) * idle.rpm / 60.0
    stands = np.interp(t, driven.t, np.abs(driven.speed)) < 0.02
    direction = rng.standard_normal((2, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    accel, gyro = np.zeros((len(t), 3)), np.zeros((len(t), 3))
    for order, share in _ORDERS:
        # Four cylinders fire twice a turn.
        frequency = 2.0 * order * idle.rpm / 60.0
        gain = 1.0 / np.sqrt(1.0 + (frequency / (0.5 * idle.rate_hz)) ** 4)
        phases = rng.uniform(0.0, 2.0 * np.pi, 4)
        wave = [share * np.sin(4.0 * np.pi * order * turns + phase) for phase in phases]
        accel += gain * np.outer(wave[0], direction[0]) + 0.5 * gain * wave[1][:, None] * rng.uniform(
            -1.0, 1.0, 3
        )
        gyro += gain * np.outer(wave[2], direction[1])
    rough = rng.uniform(0.0, _MAX_ROUGH_SHARE)
    accel += rough * np.outer(_rocking(t, rng), direction[0]) + 0.5 * rough * np.outer(
        _rocking(t, rng), direction[1]
    )
    gyro += rough * np.outer(_rocking(t, rng), direction[1])
    # The stated size is the rms at the hub before the chip's filter, over all axes together.
    size = idle.shaking * np.sqrt(2.0 / sum(share**2 for _, share in _ORDERS))
    shaking = stands[:, None] * size
    return replace(node, accel=node.accel + shaking * accel, gyro=node.gyro + _GYRO_SHARE * shaking * gyro)
