"""The closed loop that turns a level gyro axis until it points east (Robert 2014)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.sensors.north.circle import wrap
from hubodo.sensors.north.table import Turntable
from hubodo.sensors.north.tally import Tally

FEWEST_STEPS = 4
STOPS_A_STEP = 3

Measure = Callable[[float], tuple[Array, Array]]
"""Called with s; returns t (N,) s, on one clock from call to call, and the axis's rate (N,) rad/s."""


@dataclass(frozen=True)
class EastStep:
    """One maytag of the closed loop: where the axis pointed, rad, and the component found there, rad/s."""

    angle: float
    rate: float


@dataclass(frozen=True)
class East:
    """Where the loop came to rest.

    angle: of the axis that points east, rad. azimuth, sigma: of table zero, from all stops together, rad.
    steps: every one.
    """

    angle: float
    azimuth: float
    sigma: float
    steps: tuple[EastStep, ...]


def seek_east(
    table: Turntable,
    measure: Measure,
    horizontal: float,
    *,
    stop: float = 34.0,
    steps: int = 10,
    sigma: float | None = None,
    tally: Tally | None = None,
) -> East:
    """Turn the axis until it reads no Earth rate between both ways round, then make sure that it is not west.

    Each step maytags once (here, about, here again). The first two, a quarter turn apart, say roughly where
    east is, unless earlier records in `tally` do; from there the table turns by arcsin(rate / horizontal),
    less and less as steps add up, so that noise is averaged as in stochastic approximation. West is the
    loop's other zero: the last maytag, a quarter turn on, must read north. horizontal: rad/s. steps: at most;
    it ends before when all stops together know azimuth to `sigma`, rad. Raises InputError for fewer than 4
    steps.
    """
    if steps < FEWEST_STEPS:
        raise InputError(f"{steps} steps cannot close the loop; give 4 or more")
    tally = tally or Tally(horizontal)
    history: list[EastStep] = []

    def maytag(at: float) -> float:
        means = []
        for way in (0.0, math.pi, 0.0):
            reached = table.turn_to(at + way)
            means.append(tally.add(*measure(stop), reached))
        component = (means[0] - 2 * means[1] + means[2]) / 4
        history.append(EastStep(at, component))
        return component

    known = tally.azimuth()
    more = 1
    if known is None:
        more = -1
        along, across = maytag(0.0), maytag(math.pi / 2)
        angle = math.atan2(across, along) - math.pi / 2
    else:
        angle = known[0] - math.pi / 2
    while len(history) < steps - 1:
        component = maytag(angle)
        angle -= math.asin(max(-1.0, min(1.0, component / horizontal))) / (len(history) + more)
        known = tally.azimuth()
        if sigma is not None and known is not None and known[1] <= sigma:
            break
    if maytag(angle + math.pi / 2) < 0:
        angle += math.pi
    known = tally.azimuth()
    assert known is not None
    return East(float(wrap(angle)), *known, tuple(history))
