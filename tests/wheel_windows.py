"""Windows of simulated wheels, for tests of the motion model and of the spin search."""

from __future__ import annotations

import cmath
from typing import Any

import numpy as np

from hubodo.earth import STANDARD_GRAVITY
from hubodo.fuse.wheel.config import WheelConfig, WheelNode
from hubodo.fuse.wheel.preintegration import WindowBuilder
from hubodo.fuse.wheel.state_vector import InitialState, initial_state
from hubodo.fuse.wheel.window import WINDOW_S, Window

T = WINDOW_S
G, R, LIMIT = STANDARD_GRAVITY, 0.3, 34.0
"""Gravity, m/s²; wheel radius, m, and gyro limit, rad/s, of `rolling_windows`."""
Pairs = tuple[tuple[Any, Window], ...]


def make_vehicle(*names: str) -> tuple[WheelConfig, InitialState, Pairs]:
    """Return configuration, initial state and one window per wheel; all wheel angles are known."""
    nodes = {name: WheelNode(name, "left") for name in names}  # type: ignore[arg-type]
    config = WheelConfig(0.2, 0.6, nodes, position_aided=True)
    initial = initial_state(config)
    windows = []
    for number, wheel in enumerate(initial.wheels):
        wheel.angle_initialised = True
        rate = 6.0 + number
        windows.append(
            Window(
                spin=rate * T,
                rate_start=rate - 0.1,
                rate_end=rate + 0.15,
                carrier=0.098 + 0.001j,
                force=T * (9.7 + 1j * (0.7 + 0.4 * number)) * cmath.exp(-0.5j * rate * T),
                lever=0.5 - 3.5j,
                axial_variance=0.3,
            )
        )
    return config, initial, tuple(zip(initial.wheels, windows, strict=True))


def random_state(initial: InitialState, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a random state away from zero and a fully correlated covariance."""
    rng = np.random.default_rng(seed)
    size = initial.columns.size
    root = rng.standard_normal((size, size)) / np.sqrt(size)
    return 0.05 * rng.standard_normal(size), root @ root.T


def replace_windows(pairs: Pairs, **flags: float) -> Pairs:
    """Return the same wheels with fields of their windows replaced."""
    return tuple((wheel, window._replace(**flags)) for wheel, window in pairs)


def rolling_windows(
    spin: float,
    slope: float = 0.0,
    *,
    gravity: float = G,
    rate_hz: float = 104.0,
    seconds: float = 1.0,
    arm: complex = 0j,
    bias: complex = 0j,
    accel_limit: float = np.inf,
) -> list[Window]:
    """Return windows of a wheel with spin rate spin + slope t, rad/s, and an angle of 0.4 at 0 s.

    The gyro saturates at LIMIT. The hub accelerates with R times the change of the rate; the force is gravity
    and this acceleration in wheel axes, plus the bias and the lever-arm terms in node axes.
    """
    t = np.arange(-0.02, seconds + 0.05, 1.0 / rate_hz)
    rate = spin + slope * t
    angle = 0.4 + spin * t + 0.5 * slope * t * t
    force = (gravity + 1j * R * slope) * np.exp(-1j * angle) + bias + arm * (1j * slope - rate**2)
    gyro, accel = np.zeros((2, len(t), 3))
    gyro[:, 2] = np.clip(rate, -LIMIT, LIMIT)
    accel[:, 0], accel[:, 1] = force.real, force.imag
    return WindowBuilder("left", 0.0, LIMIT, accel_limit).add_many(t, gyro, accel)
