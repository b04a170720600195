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

from hubodo.arrays import Array
from hubodo.fuse.wheel.config import WheelConfig
from hubodo.fuse.wheel.entries import (
    CAMBER,
    GYRO_BIAS_X,
    GYRO_BIAS_Y,
    GYRO_BIAS_Z,
    GYRO_SCALE_ACROSS,
    GYRO_SCALE_Z,
    MISALIGNMENT_X,
    MISALIGNMENT_Y,
    RATE_BEYOND_RANGE,
    TRACK_WIDTH,
    WHEEL_ANGLE,
    WHEEL_RADIUS,
    YAW_RATE_FROM_GRAVITY,
)
from hubodo.fuse.wheel.filter_core import FilterCore
from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.preintegration import WindowBuilder
from hubodo.fuse.wheel.records import Pose, StepInput
from hubodo.fuse.wheel.state import Wheel
from hubodo.fuse.wheel.surface_speeds import SurfaceSpeeds
from hubodo.fuse.wheel.window import EMPTY_WINDOW, Window
from hubodo.vehicle import facing_sign

ALIGNMENT_WINDOWS = 10
"""Windows that are looked at together for the wheel angles before the first pose.

A second of gravity, through which a vehicle does not brake or turn one way.
"""

_MAX_NODE_DELAY_WINDOWS = 10
"""Windows by which a node may fall behind the other before it is taken as not heard.

A second, what a radio link may hold samples back.
"""


_MAX_STEPS_PER_SAMPLE = 3
"""Steps that a sample which completes a window leads to at most: the rest waits for the next windows.

When a node is heard again that was late, and at the first pose, ten are due; they are caught up with in half
a second.
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
    motion_state: MotionState


class WheelFilter:
    """Feed samples with `handle` or blocks with `handle_many`, then `finish`.

    Poses come back as windows close. A node that falls a second behind the other is taken as not heard; its
    samples of that time are lost. A time in which no node was heard is one step and one pose at its end,
    however long it is.
    """

    def __init__(self, config: WheelConfig, speeds: SurfaceSpeeds | None = None) -> None:
        """speeds: what another odometer tells, where the config says that there is one."""
        self.config = config
        self._speeds = speeds or {}
        self.core = FilterCore(config)
        self.recorded_steps: list[StepInput] | None = None
        self._builders = {
            name: WindowBuilder(node.facing, 0.0, node.gyro_limit, node.accel_limit)
            for name, node in config.nodes.items()
        }
        self._queues: dict[str, deque[Window]] = {name: deque() for name in config.nodes}
        self._number: int | None = None
        self._pending: list[StepInput] = []
        self._due: deque[StepInput] = deque()
        self._begun = False
        self._last: dict[str, WheelSample] = {}
        self._shown: dict[str, tuple[float, float, float]] = {}
        self._pose: Pose | None = None

    def handle(self, sample: WheelSample) -> FilterOutput:
        """One sample; the nodes' samples may come in any order."""
        builder = self._builders.get(sample.node)
        if builder is None:
            return FilterOutput(refused=1)
        before = builder.refused
        windows = builder.add(sample.t, sample.gyro, sample.accel)
        refused = builder.refused - before
        if builder.newest == sample.t:
            self._last[sample.node] = sample
            self._shown.pop(sample.node, None)
        if windows:
            self._queues[sample.node].extend(windows)
            self._advance(_MAX_NODE_DELAY_WINDOWS)
        return FilterOutput(self._run(_MAX_STEPS_PER_SAMPLE) if windows else (), refused)

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
        self._advance(_MAX_NODE_DELAY_WINDOWS)
        return FilterOutput(self._run(), refused)

    def finish(self) -> FilterOutput:
        """No more samples come: the windows that still waited for the other node or for the first second."""
        self._advance(0)
        self._begin()
        return FilterOutput(self._run())

    def state(self) -> WheelState | None:
        """The newest state, not more than a sample old; None before the first pose."""
        pose = self._pose
        if pose is None:
            return None
        for wheel in self.core.wheels:
            if wheel.angle_initialised and wheel.name in self._last and wheel.name not in self._shown:
                self._shown[wheel.name] = self._now(wheel)
        rates = [item for item in self._shown.values() if item[0] >= pose.t]
        if not rates or pose.motion_state is not MotionState.MOVING:
            t = max([pose.t, *(item[0] for item in rates)])
            return WheelState(t, *pose[1:4], pose.speed, pose.yaw_rate, pose.covariance, pose.motion_state)
        t = max(item[0] for item in rates)
        speed = sum(item[1] for item in rates) / len(rates)
        yaw_rate = sum(item[2] for item in rates) / len(rates)
        dt = t - pose.t
        turn = 0.5 * (yaw_rate + pose.yaw_rate) * dt
        way = 0.5 * (speed + pose.speed) * dt
        course = pose.heading + 0.5 * turn
        x, y = pose.x + way * math.cos(course), pose.y + way * math.sin(course)
        return WheelState(t, x, y, pose.heading + turn, speed, yaw_rate, pose.covariance, pose.motion_state)

    @property
    def refused(self) -> dict[str, int]:
        """Samples left out by node."""
        return {name: builder.refused for name, builder in self._builders.items()}

    def _now(self, wheel: Wheel) -> tuple[float, float, float]:
        """(t, speed, yaw rate) that the last sample of a wheel shows.

        By the equations of yaw.py and rolling.py.
        """
        sample, x, at = self._last[wheel.name], self.core.x, wheel.columns
        assert self._pose is not None
        sign = facing_sign(wheel.node.facing)
        spin = sign * sample.gyro[2]
        if abs(spin) >= wheel.node.gyro_limit:
            spin += x[at[RATE_BEYOND_RANGE]]
        else:
            spin = (spin - x[at[GYRO_BIAS_Z]]) / (1.0 + x[at[GYRO_SCALE_Z]])
        lean = x[at[CAMBER]]
        across = complex(sample.gyro[0], sign * sample.gyro[1])
        across -= complex(x[at[GYRO_BIAS_X]], x[at[GYRO_BIAS_Y]])
        across -= complex(-x[at[MISALIGNMENT_Y]], x[at[MISALIGNMENT_X]]) * spin
        angle = x[at[WHEEL_ANGLE]] + spin * (sample.t - self._pose.t)
        felt = (across * cmath.exp(1j * angle)).real - x[at[YAW_RATE_FROM_GRAVITY]]
        yaw_rate = felt / ((1.0 + x[at[GYRO_SCALE_ACROSS]]) * math.cos(lean)) - wheel.geometry.ground_rate
        rate = spin - wheel.geometry.side * yaw_rate * math.sin(lean)
        speed = wheel.geometry.radius * (1.0 + x[at[WHEEL_RADIUS]]) * rate
        contact = wheel.geometry.contact_y * (1.0 + x[at[TRACK_WIDTH]])
        return sample.t, speed + yaw_rate * contact, yaw_rate

    def _advance(self, patience: int) -> None:
        """Makes steps of the windows that need not wait any longer for another wheel's."""
        queues = list(self._queues.values())
        while any(queues):
            if self._number is not None:
                for queue in queues:
                    _drop_before(queue, self._number)
            full = [queue for queue in queues if queue]
            if not full or (len(full) < len(queues) and max(map(len, full)) <= patience):
                break
            number = min(queue[0].number for queue in full)
            if self._number is not None and number > self._number:
                self._begin()
                self._pass_over(self._number, number)
            row = tuple([_window(queue, number) for queue in queues])
            step = StepInput(row, number, self._begun, surface_speeds=self._speeds.get(number))
            (self._due if self._begun else self._pending).append(step)
            if len(self._pending) >= ALIGNMENT_WINDOWS:
                self._begin()
            self._number = number + 1

    def _pass_over(self, first: int, end: int) -> None:
        """From window `first` on up to `end` no node was heard."""
        told = [number for number in range(first, end) if number in self._speeds] if self._speeds else []
        for number in told:
            if number > first:
                self._due.append(StepInput((), number - 1, True, number - first))
            nothing = (EMPTY_WINDOW,) * len(self._queues)
            self._due.append(StepInput(nothing, number, True, surface_speeds=self._speeds[number]))
            first = number + 1
        if end > first:
            self._due.append(StepInput((), end - 1, True, end - first))

    def _begin(self) -> None:
        if self._pending:
            self._begun = True
            self.core.align([step.windows for step in self._pending])
            self._due.extend(self._pending)
            self._pending = []

    def _run(self, most: int | None = None) -> tuple[Pose, ...]:
        """The steps that are due, `most` of them at most."""
        poses = []
        for _ in range(len(self._due) if most is None else min(most, len(self._due))):
            step = self._due.popleft()
            if self.recorded_steps is not None:
                self.recorded_steps.append(step)
            poses.append(self.core.step(step, ALIGNMENT_WINDOWS))
        if poses:
            self._pose = poses[-1]
            self._shown.clear()
        return tuple(poses)


def _drop_before(queue: deque[Window], number: int) -> None:
    while queue and queue[0].number < number:
        queue.popleft()


def _window(queue: deque[Window], number: int) -> Window:
    """Window `number` of a node, taken from the queue."""
    return queue.popleft() if queue and queue[0].number == number else EMPTY_WINDOW
