"""East seeking: a closed loop that turns a level gyro axis until it points east (Robert 2014)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.sensors.north.circular import wrap_angle
from hubodo.sensors.north.running_estimate import RunningEstimate
from hubodo.sensors.north.turntable import Turntable

MIN_EAST_STEPS = 4
STOPS_PER_STEP = 3

MeasureRate = Callable[[float], tuple[Array, Array]]
"""Function that measures for a given time, s.

Returns t (N,) s, on one common clock, and the rate (N,) rad/s.
"""


@dataclass(frozen=True)
class EastStep:
    """One maytag of the closed loop: angle of the axis, rad, and Earth rate along it, rad/s."""

    angle: float
    rate: float


@dataclass(frozen=True)
class EastSeekResult:
    """The result of east seeking.

    Attributes:
        angle: angle of the axis that points east, rad.
        azimuth, sigma: azimuth of table zero and its sigma from all stops, rad.
        steps: all steps of the loop.
    """

    angle: float
    azimuth: float
    sigma: float
    steps: tuple[EastStep, ...]


def seek_east(
    table: Turntable,
    measure: MeasureRate,
    horizontal: float,
    *,
    stop: float = 34.0,
    steps: int = 10,
    sigma: float | None = None,
    tally: RunningEstimate | None = None,
) -> EastSeekResult:
    """Turn the axis until it measures no Earth rate, then check that it points east and not west.

    Each step is one maytag (angle, angle + 180°, angle). The first two steps, a quarter turn apart, give a
    rough east, unless earlier records in `tally` do. The table then turns by arcsin(rate / horizontal)
    times a gain that decreases with the number of steps, as in stochastic approximation. West is the other
    zero of the loop: the last maytag, a quarter turn on, must read north. horizontal: Earth rate along a
    level axis that points north, rad/s. stop: duration of a stop, s. steps: maximum number; the loop ends
    earlier once the azimuth sigma of all stops is at most `sigma`, rad. Raises InputError for fewer than 4
    steps.
    """
    if steps < MIN_EAST_STEPS:
        raise InputError(f"{steps} steps cannot close the loop; give 4 or more")
    tally = tally or RunningEstimate(horizontal)
    steps_done: list[EastStep] = []

    def run_maytag(angle_of_step: float) -> float:
        stop_means = []
        for offset in (0.0, math.pi, 0.0):
            reached = table.turn_to(angle_of_step + offset)
            stop_means.append(tally.add_stop(*measure(stop), reached))
        component = (stop_means[0] - 2 * stop_means[1] + stop_means[2]) / 4
        steps_done.append(EastStep(angle_of_step, component))
        return component

    estimate = tally.azimuth()
    gain_offset = 1
    if estimate is None:
        gain_offset = -1
        rate_along, rate_across = run_maytag(0.0), run_maytag(math.pi / 2)
        angle = math.atan2(rate_across, rate_along) - math.pi / 2
    else:
        angle = estimate[0] - math.pi / 2
    while len(steps_done) < steps - 1:
        component = run_maytag(angle)
        angle -= math.asin(max(-1.0, min(1.0, component / horizontal))) / (len(steps_done) + gain_offset)
        estimate = tally.azimuth()
        if sigma is not None and estimate is not None and estimate[1] <= sigma:
            break
    if run_maytag(angle + math.pi / 2) < 0:
        angle += math.pi
    estimate = tally.azimuth()
    assert estimate is not None
    return EastSeekResult(float(wrap_angle(angle)), *estimate, tuple(steps_done))
