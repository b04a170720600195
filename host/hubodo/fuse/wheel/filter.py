"""Odometer of one or two wheels: samples in, poses out, bit-identical live and in bulk.

Samples are integrated over windows of 0.1 s (`preintegration.py`), independently of all estimates. The
filter takes one step per window (`filter_core.py`). So a whole log and a stream of single samples give
bit-identical poses. No clock, file or thread.
"""

from __future__ import annotations

import cmath
import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from hubodo.arrays import Array
from hubodo.fuse.wheel.axle_rate import correct_axle_rate
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
from hubodo.fuse.wheel.records import Pose, SmoothingTerms, StepInput
from hubodo.fuse.wheel.surface_speeds import SurfaceSpeeds
from hubodo.fuse.wheel.wheel import Wheel
from hubodo.fuse.wheel.window import EMPTY_WINDOW, WINDOWS_PER_SECOND, Window
from hubodo.recording import Table
from hubodo.vehicle import facing_sign

ALIGNMENT_WINDOWS = WINDOWS_PER_SECOND
"""Windows from which wheel angles are initialised before the first pose: no vehicle brakes or turns all the
time."""

_MAX_NODE_DELAY_WINDOWS = WINDOWS_PER_SECOND
"""Windows by which a node may lag behind the other before its windows are missing."""

_MAX_STEPS_PER_SAMPLE = 3
"""Steps taken at most for one sample; the rest waits for the next windows. When a late node is received
again,
and at the first pose, ten are due; they take half a second."""


_MAX_SPEED_DELAY_WINDOWS = 2
"""Windows for which a step waits for surface speeds that arrive live: encoders report ten times a second or
more often. The state at the newest sample is extrapolated meanwhile."""

_MAX_SPEED_OUTAGE_WINDOWS = 5
"""Windows without surface speeds after which no step waits for them."""


@dataclass(frozen=True, slots=True)
class WheelSample:
    """One sample of a node. t: s on the log's clock; gyro: rad/s, accel: m/s², node axes, finite.

    beyond_range: 1.0 where a second accelerometer replaced saturated values, else 0.0.
    """

    node: str
    t: float
    gyro: tuple[float, float, float]
    accel: tuple[float, float, float]
    beyond_range: float = 0.0


BEYOND_RANGE = "beyond_range"
"""Column of a node's table with `WheelSample.beyond_range`; missing if it is always 0."""

SampleBlock = tuple[Array, Array, Array] | tuple[Array, Array, Array, Array]
"""Samples of a node: t (N,) s, gyro (N, 3) rad/s, accel (N, 3) m/s², and optionally `BEYOND_RANGE` (N,)."""


def sample_block(table: Table) -> SampleBlock:
    """Return the samples of a node's table for `WheelFilter.handle_many`."""
    samples = table.t, table.gyro, table.accel
    return (*samples, table[BEYOND_RANGE]) if BEYOND_RANGE in table else samples


@dataclass(frozen=True, slots=True)
class FilterOutput:
    """Result of processing samples.

    Attributes
    ----------
    poses : poses of the windows that the samples completed.
    n_rejected : number of samples left out because their time did not increase or their node is on no wheel.
    """

    poses: tuple[Pose, ...] = ()
    n_rejected: int = 0


@dataclass(frozen=True, slots=True)
class WheelState:
    """State of the vehicle at the time of the last sample, extrapolated from the last pose.

    Attributes
    ----------
    t : s.
    x, y, heading : m, m, rad; the heading is unwrapped.
    speed, yaw_rate : m/s, rad/s.
    covariance : (5, 5) of x, y, heading, speed, yaw_rate at the last pose.
    motion_state : moving, rocking or standstill.
    """

    t: float
    x: float
    y: float
    heading: float
    speed: float
    yaw_rate: float
    covariance: Array
    motion_state: MotionState


class _SampleRates(NamedTuple):
    """Time, s, speed, m/s, and yaw rate, rad/s, from the last sample of a wheel."""

    t: float
    speed: float
    yaw_rate: float


class WheelFilter:
    """Wheel odometry: pass samples to `handle`, or blocks to `handle_many`, then call `finish`.

    Poses are returned as windows close. The windows of a node that lags a second behind the other are
    dropped. An outage of all nodes is one step with one pose at its end, however long it is.
    """

    def __init__(self, config: WheelConfig, speeds: SurfaceSpeeds | None = None) -> None:
        """Start the filter; speeds: surface speeds of another odometer, if the config is encoder-aided."""
        self.config = config
        self._speeds = dict(speeds or {})
        self._next_speed_number: int | None = None  # None if speeds do not arrive live
        self.core = FilterCore(config)
        self.recorded_steps: list[StepInput] | None = None
        self.smoothing_terms: list[SmoothingTerms] | None = None
        self._builders = {
            name: WindowBuilder(node.facing, 0.0, node.gyro_limit, node.accel_limit)
            for name, node in config.nodes.items()
        }
        self._queues: dict[str, deque[Window]] = {name: deque() for name in config.nodes}
        self._next_number: int | None = None
        self._unaligned: list[StepInput] = []
        self._due: deque[StepInput] = deque()
        self._is_aligned = False
        self._last_samples: dict[str, WheelSample] = {}
        self._sample_rates: dict[str, _SampleRates] = {}
        self._pose: Pose | None = None

    def record_for_smoothing(self) -> None:
        """Record all steps, and their smoothing terms as long as a second pass would repeat them."""
        self.recorded_steps, self.smoothing_terms = [], []
        self.core.changes = []

    def handle(self, sample: WheelSample) -> FilterOutput:
        """Process one sample; samples of different nodes may come in any order."""
        builder = self._builders.get(sample.node)
        if builder is None:
            return FilterOutput(n_rejected=1)
        n_rejected_before = builder.n_rejected
        windows = builder.add(sample.t, sample.gyro, sample.accel, sample.beyond_range)
        n_rejected = builder.n_rejected - n_rejected_before
        if builder.newest_t == sample.t:
            self._last_samples[sample.node] = sample
            self._sample_rates.pop(sample.node, None)
        if windows:
            self._queues[sample.node].extend(windows)
            self._collect_steps(_MAX_NODE_DELAY_WINDOWS)
        return FilterOutput(self._take_steps(_MAX_STEPS_PER_SAMPLE) if windows else (), n_rejected)

    def handle_many(self, blocks: Mapping[str, SampleBlock]) -> FilterOutput:
        """Process a block of each node over the same time, by name."""
        n_rejected = 0
        for name, block in blocks.items():
            builder = self._builders.get(name)
            if builder is None:
                n_rejected += len(block[0])
                continue
            n_rejected_before = builder.n_rejected
            self._queues[name].extend(builder.add_many(*block))
            n_rejected += builder.n_rejected - n_rejected_before
        self._collect_steps(_MAX_NODE_DELAY_WINDOWS)
        return FilterOutput(self._take_steps(), n_rejected)

    def add_surface_speeds(self, speeds: SurfaceSpeeds, next_number: int) -> FilterOutput:
        """Add surface speeds of complete windows; next_number: first window whose speeds are due later."""
        first = self._next_number or 0
        self._speeds = {number: pair for number, pair in self._speeds.items() if number >= first} | speeds
        self._next_speed_number = next_number
        self._collect_steps(_MAX_NODE_DELAY_WINDOWS)
        return FilterOutput(self._take_steps(_MAX_STEPS_PER_SAMPLE))

    def finish(self) -> FilterOutput:
        """Process the windows that still wait for a node or the alignment; called after the last sample."""
        self._collect_steps(0)
        self._align()
        return FilterOutput(self._take_steps())

    def state(self) -> WheelState | None:
        """Return the state at the newest sample; None before the first pose."""
        pose = self._pose
        if pose is None:
            return None
        for wheel in self.core.wheels:
            is_new = wheel.name in self._last_samples and wheel.name not in self._sample_rates
            if wheel.angle_initialised and is_new:
                self._sample_rates[wheel.name] = self._rates_from_sample(wheel, pose)
        rates = [it for it in self._sample_rates.values() if it.t >= pose.t]
        t = max([pose.t, *(it.t for it in rates)])
        if not rates or pose.motion_state is not MotionState.MOVING:
            return WheelState(t, *pose[1:4], pose.speed, pose.yaw_rate, pose.covariance, pose.motion_state)
        speed = sum(it.speed for it in rates) / len(rates)
        yaw_rate = sum(it.yaw_rate for it in rates) / len(rates)
        dt = t - pose.t
        turn = 0.5 * (yaw_rate + pose.yaw_rate) * dt
        distance = 0.5 * (speed + pose.speed) * dt
        course = pose.heading + 0.5 * turn
        x, y = pose.x + distance * math.cos(course), pose.y + distance * math.sin(course)
        return WheelState(t, x, y, pose.heading + turn, speed, yaw_rate, pose.covariance, pose.motion_state)

    def set_pose_exact(self) -> None:
        """Declare position and heading of the newest pose exact; their covariance grows from here on."""
        self.core.set_pose_exact()
        if self._pose is not None:
            covariance = self._pose.covariance.copy()
            covariance[:3, :] = covariance[:, :3] = 0.0
            self._pose = self._pose._replace(covariance=covariance)

    @property
    def rejected_samples(self) -> dict[str, int]:
        """Return the number of samples left out, by node."""
        return {name: builder.n_rejected for name, builder in self._builders.items()}

    def _rates_from_sample(self, wheel: Wheel, pose: Pose) -> _SampleRates:
        """Return speed and yaw rate from the last sample of a wheel, by `yaw.py` and `rolling.py`."""
        sample, x, columns = self._last_samples[wheel.name], self.core.x, wheel.columns
        sign = facing_sign(wheel.node.facing)
        measured = sign * sample.gyro[2]
        is_saturated = abs(measured) >= wheel.node.gyro_limit
        beyond = x[columns[RATE_BEYOND_RANGE]] if is_saturated else 0.0
        axle_rate = correct_axle_rate(
            measured, is_saturated, x[columns[GYRO_SCALE_Z]], x[columns[GYRO_BIAS_Z]], beyond
        ).rate
        camber = x[columns[CAMBER]]
        across = complex(sample.gyro[0], sign * sample.gyro[1])
        across -= complex(x[columns[GYRO_BIAS_X]], x[columns[GYRO_BIAS_Y]])
        across -= complex(-x[columns[MISALIGNMENT_Y]], x[columns[MISALIGNMENT_X]]) * axle_rate
        angle = x[columns[WHEEL_ANGLE]] + axle_rate * (sample.t - pose.t)
        upright = (across * cmath.exp(1j * angle)).real - x[columns[YAW_RATE_FROM_GRAVITY]]
        yaw_rate = upright / ((1.0 + x[columns[GYRO_SCALE_ACROSS]]) * math.cos(camber))
        yaw_rate -= wheel.geometry.ground_rate
        rolling_rate = axle_rate - wheel.geometry.side * yaw_rate * math.sin(camber)
        speed = wheel.geometry.radius * (1.0 + x[columns[WHEEL_RADIUS]]) * rolling_rate
        contact_y = wheel.geometry.contact_y * (1.0 + x[columns[TRACK_WIDTH]])
        return _SampleRates(sample.t, speed + yaw_rate * contact_y, yaw_rate)

    def _collect_steps(self, max_delay: int) -> None:
        """Combine the windows of all nodes into steps; a node may lag by `max_delay` windows."""
        queues = list(self._queues.values())
        while any(queues):
            if self._next_number is not None:
                for queue in queues:
                    _drop_before(queue, self._next_number)
            filled = [queue for queue in queues if queue]
            if not filled or (len(filled) < len(queues) and max(map(len, filled)) <= max_delay):
                break
            number = min(queue[0].number for queue in filled)
            if max_delay and self._should_await_speeds(number, max(queue[-1].number for queue in filled)):
                break
            if self._next_number is not None and number > self._next_number:
                self._align()
                self._add_outage(self._next_number, number)
            windows = tuple([_pop_window(queue, number) for queue in queues])
            step = StepInput(windows, number, self._is_aligned, surface_speeds=self._speeds.get(number))
            (self._due if self._is_aligned else self._unaligned).append(step)
            if len(self._unaligned) >= ALIGNMENT_WINDOWS:
                self._align()
            self._next_number = number + 1

    def _should_await_speeds(self, number: int, newest: int) -> bool:
        """Return True if the surface speeds of window `number` are due to arrive soon."""
        due = self._next_speed_number
        return (
            due is not None
            and due <= number < due + _MAX_SPEED_OUTAGE_WINDOWS
            and newest < number + _MAX_SPEED_DELAY_WINDOWS
        )

    def _add_outage(self, first: int, end: int) -> None:
        """Add steps for windows `first` to `end` without any node, split where there are surface speeds."""
        measured = [number for number in range(first, end) if number in self._speeds] if self._speeds else []
        for number in measured:
            if number > first:
                self._due.append(StepInput((), number - 1, True, number - first))
            windows = (EMPTY_WINDOW,) * len(self._queues)
            self._due.append(StepInput(windows, number, True, surface_speeds=self._speeds[number]))
            first = number + 1
        if end > first:
            self._due.append(StepInput((), end - 1, True, end - first))

    def _align(self) -> None:
        """Initialise the filter from the windows so far, once."""
        if self._unaligned:
            self._is_aligned = True
            self.core.align([step.windows for step in self._unaligned])
            self._due.extend(self._unaligned)
            self._unaligned = []

    def _take_steps(self, max_steps: int | None = None) -> tuple[Pose, ...]:
        """Take the steps that are due, `max_steps` of them at most."""
        poses = []
        for _ in range(len(self._due) if max_steps is None else min(max_steps, len(self._due))):
            step = self._due.popleft()
            if self.recorded_steps is not None:
                self.recorded_steps.append(step)
            poses.append(self.core.step(step, ALIGNMENT_WINDOWS))
            if self.smoothing_terms is not None:
                self.smoothing_terms.append(self.core.newest_terms)
                if not self.core.is_single_pass:
                    self.smoothing_terms = self.core.changes = None
        if poses:
            self._pose = poses[-1]
            self._sample_rates.clear()
        return tuple(poses)


def _drop_before(queue: deque[Window], number: int) -> None:
    """Drop windows before `number`."""
    while queue and queue[0].number < number:
        queue.popleft()


def _pop_window(queue: deque[Window], number: int) -> Window:
    """Remove window `number` of a node from its queue; return an empty one if it is not there."""
    return queue.popleft() if queue and queue[0].number == number else EMPTY_WINDOW
