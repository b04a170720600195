"""The wheel filter between samples as they come and the messages on /odom and /tf, live and in playback.

What is published depends on the blocks of samples and their order alone: a log, whose blocks stand in the
order in which the recorder took them, gives the same bits again.
"""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.calibration.apply import SampleCorrection, zero_applied_effects
from hubodo.calibration.file import Calibration
from hubodo.errors import InputError
from hubodo.fuse.ranges import NodeRanges, determine_ranges
from hubodo.fuse.wheel.config import WheelConfig, wheel_config
from hubodo.fuse.wheel.drive_warnings import START_WINDOWS, list_warnings
from hubodo.fuse.wheel.entries import GYRO_BIAS_X, GYRO_BIAS_Y, GYRO_BIAS_Z
from hubodo.fuse.wheel.filter import WheelFilter, WheelSample, WheelState
from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.records import Pose
from hubodo.fuse.wheel.window import WINDOW_S
from hubodo.ingest.sink import Sink
from hubodo.log.timebase import to_seconds
from hubodo.units import NS_PER_S
from hubodo.vehicle import Vehicle, facing_sign

Vector = tuple[float, float, float]

PATIENCE_NS = 3 * NS_PER_S
"""How long after the first samples of one wheel the other is waited for."""

_JUDGED_AFTER = 10.0
_LOOK_EVERY = 50


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Samples of one node that came together.

    t_ns: (N,) measured, host clock. gyro: (N, 3) rad/s, accel: (N, 3) m/s², raw, node axes. temperature:
    degrees C, supply: V, None without. power_on_ns: host clock, None where it is not known.
    """

    node: str
    t_ns: NDArray[np.int64]
    gyro: Array
    accel: Array
    temperature: float | None
    power_on_ns: int | None
    supply: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class OdometryRows:
    """Rows of /odom, each (N, ...).

    t_ns; position (N, 2) m; heading rad; speed m/s; yaw_rate rad/s; pose_covariance (N, 3, 3) of x, y,
    heading; twist_covariance (N, 2, 2) of speed, yaw rate.
    """

    t_ns: NDArray[np.int64]
    position: Array
    heading: Array
    speed: Array
    yaw_rate: Array
    pose_covariance: Array
    twist_covariance: Array

    def write(self, sink: Sink, t_log_ns: int) -> None:
        """On /odom and /tf."""
        sink.write_odometry(
            self.t_ns,
            t_log_ns,
            self.position,
            self.heading,
            self.speed,
            self.yaw_rate,
            pose_covariance=self.pose_covariance,
            twist_covariance=self.twist_covariance,
        )
        sink.write_transform(self.t_ns, t_log_ns, self.position, self.heading)


class Odometer:
    """Odometry of one wheel or two at the rate of their samples.

    The filter begins when every wheel of the vehicle has been heard, or `PATIENCE_NS` after the first one
    was; a wheel that comes later takes no part. The first second of samples yields no pose: the wheel angle
    is being found.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        t_zero_ns: int,
        *,
        calibration: Calibration | None = None,
        rate_hz: float | None = None,
    ) -> None:
        """t_zero_ns: host time of t = 0. rate_hz: poses a second at most, None: one for every sample.

        Raises InputError when the vehicle has no node on a wheel, or two on one, CalibrationError when the
        calibration cannot be that of a node.
        """
        self._vehicle = vehicle
        self._t_zero_ns = t_zero_ns
        self._left = None if calibration is None else zero_applied_effects(calibration)
        known = {} if calibration is None else calibration.nodes
        self._corrections = {name: SampleCorrection.from_calibration(node) for name, node in known.items()}
        self._ranges: dict[str, NodeRanges] = {
            name: determine_ranges(mount, {}, corrected=name in known)
            for name, mount in vehicle.nodes.items()
        }
        self.wheels = frozenset(self._config(list(vehicle.nodes)).nodes)
        """Names of the nodes on wheels."""
        self._step_ns = 0 if rate_hz is None else round(NS_PER_S / rate_hz)
        self._waiting: deque[Block] = deque()
        self._filter: WheelFilter | None = None
        self._last_ns: int | None = None
        self._state: WheelState | None = None
        self._still = bytearray()  # of the beginning alone: a drive may last for weeks
        self._rested = False
        self._windows = 0
        self._pose: Pose | None = None
        self._said: set[str] = set()
        self._slips_said: dict[str, int] = {}
        self._looked = 0
        self._late: set[str] = set()
        self._first_ns: dict[str, int] = {}
        self._newest_ns: dict[str, int] = {}
        self._fresh: list[Pose] = []
        self.poses = 0
        """Rows published."""
        self.distance = 0.0
        """m along the track; backwards counts too."""

    @property
    def state(self) -> WheelState | None:
        """The newest published state."""
        return self._state

    @property
    def nodes(self) -> tuple[str, ...]:
        """The nodes that the filter listens to; empty before it has begun."""
        return () if self._filter is None else tuple(self._filter.config.nodes)

    @property
    def vehicle(self) -> Vehicle:
        """On whose wheels the nodes are."""
        return self._vehicle

    def biases(self) -> dict[str, tuple[Vector, Vector]]:
        """What is left of each gyro's bias behind the calibration, and its 1 sigma: rad/s, node axes."""
        found: dict[str, tuple[Vector, Vector]] = {}
        if self._filter is None:
            return found
        core = self._filter.core
        for wheel in core.wheels:
            sign = facing_sign(wheel.node.facing)
            x, y, z = (wheel.columns[entry] for entry in (GYRO_BIAS_X, GYRO_BIAS_Y, GYRO_BIAS_Z))
            sigmas = [math.sqrt(core.p[place, place]) for place in (x, y, z)]
            bias = (core.x[x], sign * core.x[y], sign * core.x[z])
            found[wheel.name] = (bias, (sigmas[0], sigmas[1], sigmas[2]))
        return found

    def told(self, node: str, text: Mapping[str, str]) -> None:
        """What a node says of itself, as the log keeps it: its ranges, if that comes before its odometry."""
        if node in self.wheels:
            mount = self._vehicle.nodes[node]
            self._ranges[node] = determine_ranges(mount, text, corrected=node in self._corrections)

    def handle(self, block: Block) -> list[OdometryRows]:
        """What a block of samples makes known, oldest first; blocks of nodes on no wheel are passed over."""
        if block.node not in self.wheels or not len(block.t_ns):
            return []
        if self._filter is not None:
            return [made for made in [self._feed(self._filter, block)] if made is not None]
        self._waiting.append(block)
        heard = {waiting.node for waiting in self._waiting}
        if heard != self.wheels and block.t_ns[-1] - self._waiting[0].t_ns[0] < PATIENCE_NS:
            return []
        return self._begin()

    def finish(self) -> list[OdometryRows]:
        """No more samples come: what waited for the other wheel."""
        made = self._begin() if self._filter is None and self._waiting else []
        if self._filter is not None:
            self._account(self._filter.finish().poses)
        return made

    def fresh(self) -> list[Pose]:
        """The filter's poses at the ends of windows that have come since the last call."""
        fresh, self._fresh = self._fresh, []
        return fresh

    def warnings(self, *, end: bool = False) -> list[str]:
        """What a user must know and has not been told yet.

        A slip is told when it is over. All else is looked for every few seconds before the end, once the
        vehicle has gone far enough to judge.
        """
        if self._filter is None or not self._windows:
            return []
        return [*self._slips(self._filter, end), *self._advice(self._filter, self._windows, end)]

    def _slips(self, wheels: WheelFilter, end: bool) -> list[str]:
        new = []
        for wheel in wheels.core.wheels:
            for slip in wheel.slip_detector.slips[self._slips_said.get(wheel.name, 0) :]:
                if end or slip.last is not None:
                    self._slips_said[wheel.name] = self._slips_said.get(wheel.name, 0) + 1
                    new.append(f"{wheel.name}: {slip.description}")
        return new

    def _advice(self, wheels: WheelFilter, windows: int, end: bool) -> list[str]:
        if not end and (self.distance < _JUDGED_AFTER or windows < self._looked + _LOOK_EVERY):
            return []
        self._looked = windows
        lines = [
            f"{name}: first heard more than {PATIENCE_NS // NS_PER_S} s after the other wheel; "
            "it takes no part in the odometry"
            for name in sorted(self._late)
        ]
        new = []
        still = np.array([*self._still, *([MotionState.STANDSTILL] if self._rested else [])], np.float64)
        for line in [*lines, *list_warnings(wheels, still)]:
            kind = re.sub(r"\d+(\.\d+)?", "#", line)
            if kind not in self._said:
                self._said.add(kind)
                new.append(line)
        return new

    def _config(self, names: list[str]) -> WheelConfig:
        try:
            return wheel_config(self._vehicle, names, self._left, self._ranges)
        except ValueError as error:
            raise InputError(
                f"odometry: {error}; give each wheel's node in the vehicle file a side and a facing"
            ) from None

    def _begin(self) -> list[OdometryRows]:
        waiting, self._waiting = self._waiting, deque()
        config = self._config(sorted({block.node for block in waiting}))
        self._filter = WheelFilter(replace(config, start_heading=0.0))
        made = [self._feed(self._filter, block) for block in waiting]
        return [motion for motion in made if motion is not None]

    def _feed(self, wheels: WheelFilter, block: Block) -> OdometryRows | None:
        if block.node not in wheels.config.nodes:
            self._late.add(block.node)
            return None
        gyro, accel = block.gyro, block.accel
        correction = self._corrections.get(block.node)
        if correction is not None:
            first_ns = self._first_ns.setdefault(block.node, int(block.t_ns[0]))
            since_ns = first_ns if block.power_on_ns is None else block.power_on_ns
            age: Array = (block.t_ns - since_ns) / NS_PER_S
            gyro, accel = correction.apply(
                gyro, accel, age=age, temperature=block.temperature, supply=block.supply
            )
        times = to_seconds(block.t_ns, self._t_zero_ns).tolist()
        # Between samples of the two wheels that fall close together one pose is enough.
        newest_ns = int(block.t_ns[-1])
        before_ns = int(block.t_ns[0]) if len(times) > 1 else self._newest_ns.get(block.node, newest_ns)
        self._newest_ns[block.node] = newest_ns
        period_ns = (newest_ns - before_ns) // max(len(times) - 1, 1)
        apart_ns = max(self._step_ns, period_ns // 2, 1)
        published: list[tuple[int, WheelState]] = []
        for t_ns, t, rate, force in zip(
            block.t_ns.tolist(), times, gyro.tolist(), accel.tolist(), strict=True
        ):
            handled = wheels.handle(WheelSample(block.node, t, tuple(rate), tuple(force)))
            if handled.poses:
                self._account(handled.poses)
            if self._last_ns is not None and t_ns - self._last_ns < apart_ns:
                continue
            state = wheels.state()
            # A newer state is that of the other wheel's sample: it has been published.
            if state is None or state.t > t:
                continue
            # While no wheel angle is known the state stays at the end of the last window.
            state_ns = t_ns - round((t - state.t) * NS_PER_S)
            if self._last_ns is not None and state_ns - self._last_ns < apart_ns:
                continue
            self._last_ns = state_ns
            published.append((state_ns, state))
        return self._motion(published) if published else None

    def _account(self, poses: tuple[Pose, ...]) -> None:
        self._fresh += poses
        for pose in poses:
            self._windows += 1
            if len(self._still) < START_WINDOWS:
                self._still.append(int(pose.motion_state))
            self._rested |= pose.motion_state == MotionState.STANDSTILL
            before, self._pose = self._pose, pose
            if before is not None and pose.t - before.t > 1.5 * WINDOW_S:
                self.distance += math.hypot(pose.x - before.x, pose.y - before.y)
            else:
                self.distance += abs(pose.speed) * WINDOW_S

    def _motion(self, rows: list[tuple[int, WheelState]]) -> OdometryRows:
        states = [state for _, state in rows]
        self._state = states[-1]
        self.poses += len(rows)
        covariance = np.array([state.covariance for state in states])
        return OdometryRows(
            np.array([t_ns for t_ns, _ in rows], np.int64),
            np.array([(state.x, state.y) for state in states]),
            np.array([state.heading for state in states]),
            np.array([state.speed for state in states]),
            np.array([state.yaw_rate for state in states]),
            covariance[:, :3, :3],
            covariance[:, 3:, 3:],
        )
