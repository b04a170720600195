"""Positions as receivers report them: antenna lever arm, latency, correlated errors and jumps.

Nothing is taken from hubodo. The slow error is a Gauss-Markov process of first order, drawn exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from generators.wheel_drives import WheelDrive


@dataclass(frozen=True)
class Receiver:
    """A receiver of positions, and its errors.

    rate_hz: rate of positions. white, slow: 1 sigma of the white error and of the error with a correlation
    time of `memory` s, m. antenna: position forward and left of the axle's middle, m. delay: latency of the
    stamps, s. jumps: number of jumps of `jump` m. excursions: number
    of jumps that return after 1 to 6 s, a multipath signal beside a house. turned: rotation of the axes, rad.
    """

    rate_hz: float = 10.0
    white: float = 0.01
    slow: float = 0.05
    memory: float = 60.0
    antenna: tuple[float, float] = (0.5, 0.1)
    delay: float = 0.01
    jumps: int = 0
    jump: float = 0.5
    excursions: int = 0
    turned: float = 1.0


def positions(drive: WheelDrive, receiver: Receiver, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return t, x, y of the reported positions, (M,) each: s and m."""
    rng = np.random.default_rng(seed)
    t = np.arange(receiver.delay, drive.t[-1], 1.0 / receiver.rate_hz)
    at = t - receiver.delay
    heading = np.interp(at, drive.t, drive.heading)
    place = np.interp(at, drive.t, drive.x) + 1j * np.interp(at, drive.t, drive.y)
    place += complex(*receiver.antenna) * np.exp(1j * heading)
    place += receiver.white * _complex(rng, len(t)) + _lasting(rng, receiver, len(t))
    for start in rng.integers(len(t) // 5, len(t), receiver.jumps):
        place[start:] += receiver.jump * np.exp(2j * np.pi * rng.random())
    for start in rng.integers(len(t) // 10, len(t), receiver.excursions):
        end = start + int(rng.uniform(1.0, 6.0) * receiver.rate_hz)
        place[start:end] += rng.uniform(0.5, 2.0) * receiver.jump * np.exp(2j * np.pi * rng.random())
    place *= np.exp(1j * receiver.turned)
    return t, place.real, place.imag


def _lasting(rng: np.random.Generator, receiver: Receiver, count: int) -> np.ndarray:
    keep = np.exp(-1.0 / (receiver.rate_hz * receiver.memory))
    errors = np.empty(count, complex)
    value = receiver.slow * _complex(rng, 1)[0]
    for k, news in enumerate(_complex(rng, count)):
        errors[k] = value
        value = keep * value + receiver.slow * np.sqrt(1.0 - keep * keep) * news
    return errors


def _complex(rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.standard_normal(count) + 1j * rng.standard_normal(count)
