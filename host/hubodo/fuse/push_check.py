"""Check of a vehicle file by a push: the vehicle is pushed straight ahead by a measured distance."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.recording import Recording, Table
from hubodo.vehicle import Vehicle, facing_sign

TAPE_SIGMA = 0.01  # m, of the distance pushed
GYRO_SCALE_SIGMA = 0.01  # relative; data sheets state 1 to 3 % tolerance
STANDSTILL_DURATION = 1.0  # s, before and after the push
_MAX_STANDSTILL_RATE = 0.05  # rad/s, spread of the gyro at standstill
_MIN_ANGLE = 0.5  # rad; a smaller turn of the wheel shows no radius


@dataclass(frozen=True)
class WheelPush:
    """Result of the push for one wheel, from the gyro of its node.

    Attributes
    ----------
    node : name of the node.
    angle : rad by which the wheel turned, positive forwards.
    radius : m, the distance over the angle.
    sigma : m, 1 sigma of the radius.
    problem : error of the vehicle file as text; empty if the file agrees within 3 sigma.
    """

    node: str
    angle: float
    radius: float
    sigma: float
    problem: str


def check_push(recording: Recording, vehicle: Vehicle, distance: float, log: str) -> tuple[WheelPush, ...]:
    """Return the radius of each wheel with a node, from the angle by which it turned.

    distance: m, length of the push. log: name of the log, for errors. Raises InputError if a wheel moves at
    the start or end, turns too little, or no wheel has a node.
    """
    pushes = []
    for name, mount in vehicle.nodes.items():
        if mount.side is None or mount.facing is None or name not in recording.nodes:
            continue
        angle, angle_sigma = _wheel_angle(recording.nodes[name], f"{log}: {name}")
        angle *= facing_sign(mount.facing)
        if abs(angle) < _MIN_ANGLE:
            raise InputError(f"{log}: {name}: the wheel turned by {math.degrees(angle):.0f}°; push further")
        radius = distance / abs(angle)
        sigma = radius * math.hypot(TAPE_SIGMA / distance, GYRO_SCALE_SIGMA, angle_sigma / angle)
        pushes.append(WheelPush(name, angle, radius, sigma, _problem(vehicle, angle, radius, sigma)))
    if not pushes:
        raise InputError(f"{log}: holds no wheel node of the vehicle")
    return tuple(pushes)


def _wheel_angle(table: Table, where: str) -> tuple[float, float]:
    """Return the integral of gz without its bias, and its 1 sigma from the bias, rad."""
    t, rate = table.t, table["gz"]
    first, last = rate[t < t[0] + STANDSTILL_DURATION], rate[t > t[-1] - STANDSTILL_DURATION]
    if t[-1] - t[0] < 3.0 * STANDSTILL_DURATION or max(_spread(first), _spread(last)) > _MAX_STANDSTILL_RATE:
        raise InputError(
            f"{where}: moves at the begin or end of the log; let the vehicle stand {STANDSTILL_DURATION:g} s "
            "before and after the push"
        )
    before, after = float(np.mean(first)), float(np.mean(last))
    bias_sigma = max(abs(before - after), _spread(first) / math.sqrt(len(first)))
    return float(np.trapezoid(rate - 0.5 * (before + after), t)), bias_sigma * float(t[-1] - t[0])


def _spread(rate: Array) -> float:
    """Return the standard deviation of gyro rates; infinite without samples."""
    return float(np.std(rate)) if len(rate) else math.inf


def _problem(vehicle: Vehicle, angle: float, radius: float, sigma: float) -> str:
    """Return the error of the vehicle file as text; empty if the push agrees with it within 3 sigma."""
    if angle < 0.0:
        return "turned backwards: its facing is wrong, or the vehicle was pushed backwards"
    if abs(radius - vehicle.wheel_radius) <= 3.0 * sigma:
        return ""
    ratio = vehicle.wheel_radius / radius
    if abs(ratio - 2.0) < 0.1:
        return "the file has the diameter of the wheel in place of its radius"
    return f"the file has {ratio:.2f} times this radius; measure the wheel and the distance again"
