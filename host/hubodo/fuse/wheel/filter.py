"""The odometer of one or two wheels: samples in, poses out, live and in bulk by the same numbers.

Samples are boiled down to windows of a tenth of a second (preintegration.py) in which no estimate enters; the
filter takes one step per window (step.py). So a log in one piece and a stream of single samples give
the same bits, and an hour takes seconds. No clock, file or thread.
"""

from __future__ import annotations

import cmath
import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from hubodo.arrays import Array
from hubodo.fuse.wheel.config import WheelConfig
from hubodo.fuse.wheel.entries import (
    CAMBER,
    EXCESS,
    GYRO_BIAS_X,
    GYRO_BIAS_Y,
    GYRO_BIAS_Z,
    GYRO_SCALE_ACROSS,
    GYRO_SCALE_Z,
    MISALIGNMENT_X,
    MISALIGNMENT_Y,
    TRACK_WIDTH,
    WHEEL_ANGLE,
    WHEEL_RADIUS,
    YAW_RATE_FROM_GRAVITY,
)
from hubodo.fuse.wheel.preintegration import NOTHING, Window, WindowBuilder
from hubodo.fuse.wheel.state import Wheel
from hubodo.fuse.wheel.step import Pose, WheelStep
from hubodo.fuse.wheel.stillness import Stillness
from hubodo.vehicle import facing_sign

LISTENED = 10
"""Windows that are looked at together for the wheel angles before the first pose.

A second of gravity, through which a vehicle does not brake or turn one way.
"""

_PATIENCE = 10
"""Windows by which a node may fall behind the other before it is taken as not heard.

A second, what a radio link may hold samples back.
"""


@dataclass(frozen=True, slots=True)
class WheelSample:
    """One sample of a node. t: s on the log's clock; gyro: rad/s, accel: m/s², node axes, finite."""

    node: str
    t: float
    gyro: tuple[float, float, float]
    accel: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class FilterOutput:
    """What samples led to.

    poses: of the windows they completed. refused: how many were left out because their time did not increase
    or their node is on no wheel.
    """

    poses: tuple[Pose, ...] = ()
    refused: int = 0


@dataclass(frozen=True, slots=True)
class WheelState:
    """Where the vehicle is at time t of the last sample: the last pose carried on by the last samples.

    t: s; x, y: m; heading: rad, unwrapped; speed: m/s; yaw_rate: rad/s. covariance: (5, 5) of x, y, heading,
    speed, yaw_rate at the last pose. still: whether the vehicle stands still.
    """

    t: float
    x: float
    y: float
    heading: float
    speed: float
    yaw_rate: float
    covariance: Array
    still: Stillness


class Step(NamedTuple):
    """The windows of all wheels of one number, in the order of the nodes; listen: see WheelStep.step."""

    windows: tuple[Window, ...]
    number: int
    listen: bool


class WheelFilter:
    """Feed samples with `handle` or blocks with `handle_many`, then `finish`.

    Poses come back as windows close. A node that falls a second behind the other is taken as not heard; its
    samples of that time are lost.
    """

    def __init__(self, config: WheelConfig) -> None:
        self.config = config
        self.core = WheelStep(config)
        self.steps: list[Step] | None = None
        self._builders = {
            name: WindowBuilder(node.facing, 0.0, node.gyro_limit, node.accel_limit)
            for name, node in config.nodes.items()
        }
        self._queues: dict[str, deque[Window]] = {name: deque() for name in config.nodes}
        self._number: int | None = None
        self._pending: list[Step] = []
        self._last: dict[str, WheelSample] = {}
        self._pose: Pose | None = None

    def handle(self, sample: WheelSample) -> FilterOutput:
        """One sample; the nodes' samples may come in any order."""
        builder = self._builders.get(sample.node)
        if builder is None:
            return FilterOutput(refused=1)
        before = builder.refused
        windows = builder.add(sample.t, sample.gyro, sample.accel)
        if builder.refused > before:
            return FilterOutput(refused=1)
        self._last[sample.node] = sample
        if not windows:
            return FilterOutput()
        self._queues[sample.node].extend(windows)
        return FilterOutput(self._advance(_PATIENCE))

    def handle_many(self, blocks: Mapping[str, tuple[Array, Array, Array]]) -> FilterOutput:
        """A block of each node, over the same time.

        By name: t (N,) s, gyro (N, 3) rad/s, accel (N, 3) m/s².
        """
        refused = 0
        for name, (t, gyro, accel) in blocks.items():
            builder = self._builders.get(name)
            if builder is None:
                refused += len(t)
                continue
            before = builder.refused
            self._queues[name].extend(builder.add_many(t, gyro, accel))
            refused += builder.refused - before
        return FilterOutput(self._advance(_PATIENCE), refused)

    def finish(self) -> FilterOutput:
        """No more samples come: the windows that still waited for the other node or for the first second."""
        poses = self._advance(0)
        return FilterOutput(poses + self._begin())

    def state(self) -> WheelState | None:
        """The newest state, not more than a sample old; None before the first pose."""
        pose = self._pose
        if pose is None:
            return None
        now = [self._now(wheel) for wheel in self.core.wheels if wheel.joined and wheel.name in self._last]
        rates = [item for item in now if item is not None and item[0] >= pose.t]
        if not rates or pose.still is not Stillness.MOVING:
            t = max([pose.t, *(item[0] for item in rates)])
            return WheelState(t, *pose[1:4], pose.speed, pose.yaw_rate, pose.covariance, pose.still)
        t = max(item[0] for item in rates)
        speed = sum(item[1] for item in rates) / len(rates)
        yaw_rate = sum(item[2] for item in rates) / len(rates)
        dt = t - pose.t
        turn = 0.5 * (yaw_rate + pose.yaw_rate) * dt
        way = 0.5 * (speed + pose.speed) * dt
        course = pose.heading + 0.5 * turn
        x, y = pose.x + way * math.cos(course), pose.y + way * math.sin(course)
        return WheelState(t, x, y, pose.heading + turn, speed, yaw_rate, pose.covariance, pose.still)

    @property
    def refused(self) -> dict[str, int]:
        """Samples left out by node."""
        return {name: builder.refused for name, builder in self._builders.items()}

    def _now(self, wheel: Wheel) -> tuple[float, float, float] | None:
        """(t, speed, yaw rate) that the last sample of a wheel shows.

        By the equations of yaw.py and rolling.py.
        """
        sample, x, at = self._last[wheel.name], self.core.x, wheel.at
        assert self._pose is not None
        sign = facing_sign(wheel.node.facing)
        spin = sign * sample.gyro[2]
        if abs(spin) >= wheel.node.gyro_limit:
            spin += x[at[EXCESS]]
        else:
            spin = (spin - x[at[GYRO_BIAS_Z]]) / (1.0 + x[at[GYRO_SCALE_Z]])
        lean = x[at[CAMBER]]
        across = complex(sample.gyro[0], sign * sample.gyro[1])
        across -= complex(x[at[GYRO_BIAS_X]], x[at[GYRO_BIAS_Y]])
        across -= complex(-x[at[MISALIGNMENT_Y]], x[at[MISALIGNMENT_X]]) * spin
        angle = x[at[WHEEL_ANGLE]] + spin * (sample.t - self._pose.t)
        felt = (across * cmath.exp(1j * angle)).real - x[at[YAW_RATE_FROM_GRAVITY]]
        yaw_rate = felt / ((1.0 + x[at[GYRO_SCALE_ACROSS]]) * math.cos(lean))
        rate = spin - wheel.geometry.side * yaw_rate * math.sin(lean)
        speed = wheel.geometry.radius * (1.0 + x[at[WHEEL_RADIUS]]) * rate
        contact = wheel.geometry.contact * (1.0 + x[at[TRACK_WIDTH]])
        return sample.t, speed + yaw_rate * contact, yaw_rate

    def _advance(self, patience: int) -> tuple[Pose, ...]:
        poses: list[Pose] = []
        queues = list(self._queues.values())
        while any(queues):
            if self._number is None or not all(queues):
                full = [queue for queue in queues if queue]
                oldest = min(queue[0].number for queue in full)
                newest = max(queue[-1].number for queue in full)
                if len(full) < len(queues) and newest - (self._number or oldest) < patience:
                    break
                if self._number is None:
                    self._number = oldest
            number = self._number
            row = tuple([_window(queue, number) for queue in queues])
            poses += self._take(Step(row, number, self._pose is not None))
            self._number = number + 1
        return tuple(poses)

    def _take(self, step: Step) -> tuple[Pose, ...]:
        if self._pose is None:
            self._pending.append(step)
            return self._begin() if len(self._pending) >= LISTENED else ()
        return (self._run(step),)

    def _begin(self) -> tuple[Pose, ...]:
        pending, self._pending = self._pending, []
        if pending:
            self.core.begin([step.windows for step in pending])
        return tuple(self._run(step) for step in pending)

    def _run(self, step: Step) -> Pose:
        if self.steps is not None:
            self.steps.append(step)
        self._pose = self.core.step(step.windows, step.number, step.listen, LISTENED)
        return self._pose


def _window(queue: deque[Window], number: int) -> Window:
    """Window `number` of a node, taken from the queue with those before it."""
    while queue and queue[0].number < number:
        queue.popleft()
    return queue.popleft() if queue and queue[0].number == number else NOTHING
