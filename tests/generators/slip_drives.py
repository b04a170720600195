"""Drives in which wheels leave the road or spin on it, over hills and rough roads.

Made by `wheel_drives`, so without the model under test: the hub goes where the vehicle goes, the wheel turns
as it is told here.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from generators.wheel_drives import RATE_HZ, Errors, Plan, WheelDrive, _smooth, drive, loop


def hilly(plan: Plan, rng: np.random.Generator, grade: float = 0.06, rough: float = 0.002) -> Plan:
    """The plan on a road that climbs and falls by up to some `grade` within tens of metres.

    rough: m rms of unevenness that lasts for half a metre of the way (an exponential correlation, the decline
    of two decades by decade that ISO 8608 has), smoothed by a tyre of 5 cm.
    """
    distance = np.concatenate([[0.0], np.cumsum(np.abs(plan.speed))]) / RATE_HZ
    step = 0.01
    at = np.arange(0.0, distance[-1] + 1.0, step)
    height = np.zeros(len(at))
    for length in (30.0, 55.0, 90.0):
        # The steepest of a sine of amplitude A and length L is 2 pi A / L.
        amplitude = grade / 3.0 * length / (2.0 * np.pi) * rng.uniform(0.5, 1.0)
        height += amplitude * np.sin(2.0 * np.pi * (at / length + rng.uniform()))
    fade = np.exp(-step / 0.5)
    bumps = np.empty(len(at))
    value = 0.0
    for place, kick in enumerate(rng.standard_normal(len(at)).tolist()):
        value = fade * value + rough * np.sqrt(1.0 - fade * fade) * kick
        bumps[place] = value
    kernel = np.hanning(11)
    height += np.convolve(bumps, kernel / kernel.sum(), "same")
    # Steps of a centimetre would be jerks at 1 kHz.
    return replace(plan, height=_smooth(np.interp(distance[:-1], at, height), 0.02))


def driven_loop(rng: np.random.Generator, length: float = 120.0) -> Plan:
    """Once round in `length` m, as `loop`, on a hilly and rough road."""
    return hilly(loop(rng, length, 6.0), rng)


def moving_time(plan: Plan, rng: np.random.Generator, duration: float) -> float:
    """s; a time from which on the vehicle moves for so long."""
    moves = np.flatnonzero(np.abs(plan.speed) > 0.5) / RATE_HZ
    return float(rng.uniform(moves[0] + 4.0, moves[-1] - duration - 4.0))


def lifted(plan: Plan, node: str, start: float, duration: float, ends_at: float, lasts: float) -> Plan:
    """The plan with one wheel in the air.

    It leaves the road with the speed that it has, comes to `ends_at` times the vehicle's speed by then with a
    time constant of `lasts` s, and is back on the road's speed within two tenths after it touches down.
    """
    t = np.arange(len(plan.speed)) / RATE_HZ
    first, last = int(start * RATE_HZ), int((start + duration) * RATE_HZ)
    wheel = plan.speed.copy()
    span = t[first:last] - t[first]
    start_speed = plan.speed[first]
    wheel[first:last] = start_speed * (ends_at + (1.0 - ends_at) * np.exp(-span / lasts))
    slip = _smooth(wheel - plan.speed, 0.05)
    return replace(plan, slip={**plan.slip, node: plan.slip.get(node, 0.0) + slip})


def spinning(plan: Plan, nodes: tuple[str, ...], start: float, duration: float, times: float) -> Plan:
    """The plan with wheels that turn `times` as fast as they roll from `start` on, for `duration` s."""
    t = np.arange(len(plan.speed)) / RATE_HZ
    share = _smooth(((t > start) & (t < start + duration)).astype(float), 0.1)
    slip = (times - 1.0) * plan.speed * share
    return replace(plan, slip={**plan.slip, **dict.fromkeys(nodes, slip)})


def steered(
    rng: np.random.Generator, errors: Errors, side: str, wheelbase: float = 0.6, length: float = 120.0
) -> WheelDrive:
    """A drive whose `side` node sits on the steered wheel in front of the other one's axle.

    The vehicle turns about a point on the rear axle: the front contact at (wheelbase, y) moves with
    (v - r y, r wheelbase), and its wheel points there. Each wheel is a drive of its own along the way of its
    contact, with the heading of the wheel; the truth is that of the rear axle's middle.
    """
    plan = loop(rng, length, 6.0)
    # Turning needs motion: the curvature of the way is what is steered.
    curvature = np.clip(plan.yaw_rate / np.maximum(plan.speed, 0.5), -1.2, 1.2)
    plan = replace(plan, yaw_rate=curvature * plan.speed)
    whole = drive(plan, rng, errors)
    y = (0.5 if side == "left" else -0.5) * whole.track
    ahead, across = 1.0 - curvature * y, curvature * wheelbase
    angle = np.arctan2(across, ahead)
    own = Plan(plan.speed * np.hypot(ahead, across), plan.yaw_rate + np.gradient(angle) * RATE_HZ)
    front = drive(own, rng, errors, track=1e-6).nodes[side]
    return replace(whole, nodes={**whole.nodes, side: front})
