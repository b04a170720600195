"""The closed loop that turns a level gyro axis until it points east (Robert 2014)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.errors import InputError
from hubodo.sensors.north.averages import Averages
from hubodo.sensors.north.circle import summarise, wrap
from hubodo.sensors.north.find import horizontal_rate
from hubodo.sensors.north.ml import estimate
from hubodo.sensors.north.table import Turntable

Array = NDArray[np.float64]

PARTS = 4

Measure = Callable[[float], tuple[Array, Array]]
"""Called with s; returns t (N,) s, on one clock from call to call, and the axis's rate (N,) rad/s."""


@dataclass(frozen=True)
class EastStep:
    """One maytag of the closed loop: where the table stood, rad, and the component found there, rad/s."""

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
    latitude: float,
    *,
    start: float = 0.0,
    stop: float = 34.0,
    steps: int = 10,
) -> East:
    """Turn the axis until it reads no Earth rate between both ways round, then make sure that it is not west.

    Each step maytags once (here, about, here again). The first two, a quarter turn apart, say roughly where
    east is; from there the table turns by arcsin(rate / horizontal), less and less as steps add up, so that
    noise is averaged as in stochastic approximation. West is the loop's other zero: the last maytag, a
    quarter turn on, must read north. Raises InputError for fewer than 4 steps.
    """
    if steps < 4:
        raise InputError(f"{steps} steps cannot close the loop; give 4 or more")
    horizontal = horizontal_rate(latitude)
    angle, history = start, []
    rows: list[tuple[float, float, float, float, float, float]] = []

    def maytag(at: float) -> float:
        means = []
        for way in (0.0, math.pi, 0.0):
            table.turn_to(at + way)
            t, rate = measure(stop)
            means.append(float(rate.mean()))
            step = float(np.median(np.diff(t)))
            for part in np.array_split(np.arange(len(t)), PARTS):
                rows.append(
                    (
                        t[part[0]],
                        t[part[-1]] + step,
                        rate[part].mean(),
                        math.cos(at + way),
                        math.sin(at + way),
                        0.0,
                    )
                )
        component = (means[0] - 2 * means[1] + means[2]) / 4
        history.append(EastStep(at, component))
        return component

    along, across = maytag(angle), maytag(angle + math.pi / 2)
    angle += math.atan2(across, along) - math.pi / 2
    for k in range(steps - 3):
        component = maytag(angle)
        angle -= math.asin(max(-1.0, min(1.0, component / horizontal))) / (k + 2)
    if maytag(angle + math.pi / 2) < 0:
        angle += math.pi
    posterior = estimate([Averages(*np.array(rows).T)], horizontal)
    azimuth, sigma, _ = summarise(posterior)
    return East(float(wrap(angle)), azimuth, sigma, tuple(history))
