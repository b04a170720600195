"""Odometry by the wheel filter from blocks of samples to rows of /odom and /tf, live and in playback.

The result depends only on the blocks of samples and their order. A log holds the blocks in the order in which
the recorder processed them, so playback reproduces the result bit by bit.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from hubodo.arrays import Array
from hubodo.calibration.apply import SampleCorrection, zero_applied_effects
from hubodo.calibration.file import Calibration
from hubodo.errors import InputError
from hubodo.fuse.ranges import NodeRanges, determine_ranges, uncorrected_accel_limit
from hubodo.fuse.wheel.config import WheelConfig, wheel_config
from hubodo.fuse.wheel.entries import GYRO_BIAS_X, GYRO_BIAS_Y, GYRO_BIAS_Z
from hubodo.fuse.wheel.filter import WheelFilter
from hubodo.fuse.wheel.preintegration import WheelSample
from hubodo.fuse.wheel.records import Pose
from hubodo.fuse.wheel.surface_speeds import SurfaceSpeedAverager, SurfaceSpeeds
from hubodo.fuse.wheel.window import WINDOW_S
from hubodo.ingest.live.block_extension import BlockExtension
from hubodo.ingest.live.continuous_odom import ContinuousOdom
from hubodo.ingest.live.odometer_warnings import MAX_WHEEL_WAIT_NS, OdometerWarnings
from hubodo.ingest.live.odometry_rows import OdometryRows
from hubodo.log.records import HighGSamples, ImuBlock, NodeSamples
from hubodo.log.timebase import to_seconds
from hubodo.units import NS_PER_S
from hubodo.vehicle import Vehicle, facing_sign

Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class SpeedSample:
    """Surface speeds of the left and the right wheel, m/s, from another odometer; t_ns: host time."""

    t_ns: int
    left: float
    right: float


class Odometer:
    """Odometry from the nodes on one or two wheels, at the rate of their samples.

    The filter starts once samples of every wheel node were received, or `MAX_WHEEL_WAIT_NS` after the first;
    a node received later is not used. The first second of samples yields no pose, because the wheel angle is
    being initialised.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        t_zero_ns: int,
        *,
        calibration: Calibration | None = None,
        rate_hz: float | None = None,
        encoder_aided: bool = False,
    ) -> None:
        """Start without samples.

        t_zero_ns: host time of t = 0. rate_hz: maximum rate of poses, None for one per sample. encoder_aided:
        another odometer reports surface speeds to `add_surface_speeds`. Raises
        InputError when the vehicle has no node on a wheel, or two on one wheel, CalibrationError for a
        calibration that does not fit a node.
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
        self.wheel_nodes = frozenset(self._config(list(vehicle.nodes)).nodes)
        """Names of the nodes on wheels."""
        self._step_ns = 0 if rate_hz is None else round(NS_PER_S / rate_hz)
        self._waiting: deque[ImuBlock] = deque()
        self._averager = SurfaceSpeedAverager() if encoder_aided else None
        self._extensions: dict[str, BlockExtension] = {}
        self._early_speeds: SurfaceSpeeds = {}
        self._filter: WheelFilter | None = None
        self._last_ns: int | None = None
        self._state: Pose | None = None
        self._continuous = ContinuousOdom()
        self._warnings = OdometerWarnings()
        self._pose: Pose | None = None
        self._late_nodes: set[str] = set()
        self._first_ns: dict[str, int] = {}
        self._newest_ns: dict[str, int] = {}
        self._new_poses: list[Pose] = []
        self.pose_count = 0
        """Number of published rows."""
        self.distance = 0.0
        """Distance along the track, m; driving backwards adds to it."""

    @property
    def state(self) -> Pose | None:
        """Newest published pose; None before the first."""
        return self._state

    @property
    def nodes(self) -> tuple[str, ...]:
        """Names of the nodes used by the filter; empty before its start."""
        return () if self._filter is None else tuple(self._filter.config.nodes)

    @property
    def vehicle(self) -> Vehicle:
        """Vehicle that carries the nodes."""
        return self._vehicle

    def biases(self) -> dict[str, tuple[Vector, Vector]]:
        """Return each node's residual gyro bias after calibration and its 1 sigma: rad/s, node axes."""
        biases: dict[str, tuple[Vector, Vector]] = {}
        if self._filter is None:
            return biases
        core = self._filter.core
        for wheel in core.wheels:
            sign = facing_sign(wheel.node.facing)
            x, y, z = (wheel.columns[entry] for entry in (GYRO_BIAS_X, GYRO_BIAS_Y, GYRO_BIAS_Z))
            sigmas = [math.sqrt(core.p[index, index]) for index in (x, y, z)]
            bias = (core.x[x], sign * core.x[y], sign * core.x[z])
            biases[wheel.name] = (bias, (sigmas[0], sigmas[1], sigmas[2]))
        return biases

    def update_ranges(self, node: str, text: Mapping[str, str]) -> None:
        """Update a node's measuring ranges from its Hello metadata; effective before the filter starts."""
        if node in self.wheel_nodes:
            mount = self._vehicle.nodes[node]
            self._ranges[node] = determine_ranges(mount, text, corrected=node in self._corrections)

    def handle(self, samples: NodeSamples) -> list[OdometryRows]:
        """Process samples of a node and return new rows, oldest first; other nodes' samples are ignored."""
        node = samples.node
        if node not in self.wheel_nodes or not len(samples.t_ns):
            return []
        extension = self._extensions.get(node)
        if isinstance(samples, HighGSamples):
            if extension is None:
                limit = uncorrected_accel_limit(self._ranges[node].accel.value)
                extension = self._extensions[node] = BlockExtension(limit, self._t_zero_ns)
            blocks = extension.add_chip(samples)
        else:
            blocks = [samples] if extension is None else extension.add_block(samples)
        return [rows for block in blocks for rows in self._handle_block(block)]

    def _handle_block(self, block: ImuBlock) -> list[OdometryRows]:
        if self._filter is not None:
            return [rows for rows in [self._filter_block(self._filter, block)] if rows is not None]
        self._waiting.append(block)
        received = {waiting.node for waiting in self._waiting}
        if received != self.wheel_nodes and block.t_ns[-1] - self._waiting[0].t_ns[0] < MAX_WHEEL_WAIT_NS:
            return []
        return self._start_filter()

    def add_surface_speeds(self, sample: SpeedSample) -> None:
        """Add the surface speeds of another odometer; the next samples of the nodes publish their effect."""
        if self._averager is None:
            return
        t = float(to_seconds(np.array([sample.t_ns], np.int64), self._t_zero_ns)[0])
        speeds = self._averager.add(t, sample.left, sample.right)
        if self._filter is None:
            self._early_speeds |= speeds
        else:
            self._pass_speeds_on(self._filter, speeds)

    def _pass_speeds_on(self, wheels: WheelFilter, speeds: SurfaceSpeeds) -> None:
        if self._averager is not None and self._averager.next_number is not None:
            self._add_poses(wheels.add_surface_speeds(speeds, self._averager.next_number).poses)

    def finish(self) -> list[OdometryRows]:
        """Process the blocks that waited for the other wheel, finish the filter, and return the new rows."""
        blocks = [block for extension in self._extensions.values() for block in extension.finish()]
        rows = [motion for block in blocks for motion in self._handle_block(block)]
        rows += self._start_filter() if self._filter is None and self._waiting else []
        if self._filter is not None:
            self._add_poses(self._filter.finish().poses)
        return rows

    def set_pose(self, x: float, y: float, heading: float, covariance: Array) -> None:
        """Set the pose of the vehicle in the frame odom, with its covariance (3, 3): m, m, rad.

        /odom jumps there with the next sample. Sensor errors that the filter knows stay known.
        """
        self._continuous.set_pose(x, y, heading, covariance)
        if self._filter is not None:
            self._filter.set_pose_exact()

    def take_poses(self) -> list[Pose]:
        """Return the filter's poses at the ends of windows since the last call."""
        fresh, self._new_poses = self._new_poses, []
        return fresh

    def warnings(self, *, end: bool = False) -> list[str]:
        """Return the warnings that were not reported yet; end: the drive is over."""
        if self._filter is None:
            return []
        return self._warnings.new_warnings(self._filter, self.distance, self._late_nodes, end=end)

    def _config(self, names: list[str]) -> WheelConfig:
        try:
            return wheel_config(self._vehicle, names, self._left, self._ranges)
        except ValueError as error:
            raise InputError(
                f"odometry: {error}; give each wheel's node in the vehicle file a side and a facing"
            ) from None

    def _start_filter(self) -> list[OdometryRows]:
        waiting, self._waiting = self._waiting, deque()
        config = self._config(sorted({block.node for block in waiting}))
        config = replace(config, start_heading=0.0, encoder_aided=self._averager is not None)
        self._filter = WheelFilter(config)
        self._pass_speeds_on(self._filter, self._early_speeds)
        self._early_speeds = {}
        rows = [self._filter_block(self._filter, block) for block in waiting]
        return [motion for motion in rows if motion is not None]

    def _filter_block(self, wheels: WheelFilter, block: ImuBlock) -> OdometryRows | None:
        if block.node not in wheels.config.nodes:
            self._late_nodes.add(block.node)
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
        # One pose is sufficient for samples of both wheels at nearly the same time.
        newest_ns = int(block.t_ns[-1])
        before_ns = int(block.t_ns[0]) if len(times) > 1 else self._newest_ns.get(block.node, newest_ns)
        self._newest_ns[block.node] = newest_ns
        period_ns = (newest_ns - before_ns) // max(len(times) - 1, 1)
        min_interval_ns = max(self._step_ns, period_ns // 2, 1)
        published: list[tuple[int, Pose]] = []
        beyond_range = (
            itertools.repeat(0.0, len(times)) if block.beyond_range is None else block.beyond_range.tolist()
        )
        for t_ns, t, rate, force, beyond in zip(
            block.t_ns.tolist(), times, gyro.tolist(), accel.tolist(), beyond_range, strict=True
        ):
            handled = wheels.handle(WheelSample(block.node, t, tuple(rate), tuple(force), beyond))
            if handled.poses:
                self._add_poses(handled.poses)
            if self._last_ns is not None and t_ns - self._last_ns < min_interval_ns:
                continue
            state = wheels.state()
            # A newer state belongs to a sample of the other wheel and was published already.
            if state is None or state.t > t:
                continue
            # While the wheel angle is unknown, the state stays at the end of the last window.
            state_ns = t_ns - round((t - state.t) * NS_PER_S)
            if self._last_ns is not None and state_ns - self._last_ns < min_interval_ns:
                continue
            self._last_ns = state_ns
            published.append((state_ns, self._slew(state)))
        return self._build_rows(published) if published else None

    def _slew(self, state: Pose) -> Pose:
        """Return the state to publish, without jumps."""
        x, y, heading = self._continuous.update(
            state.t, state.x, state.y, state.heading, state.speed, state.yaw_rate
        )
        covariance = self._continuous.covariance(state.covariance)
        return state._replace(x=x, y=y, heading=heading, covariance=covariance)

    def _add_poses(self, poses: tuple[Pose, ...]) -> None:
        self._new_poses += [
            pose._replace(published=self._continuous.to_published(pose.x, pose.y, pose.heading))
            for pose in poses
        ]
        for pose in poses:
            self._warnings.add_window(pose.motion_state)
            before, self._pose = self._pose, pose
            if before is not None and pose.t - before.t > 1.5 * WINDOW_S:
                self.distance += math.hypot(pose.x - before.x, pose.y - before.y)
            else:
                self.distance += abs(pose.speed) * WINDOW_S

    def _build_rows(self, rows: list[tuple[int, Pose]]) -> OdometryRows:
        times, states = zip(*rows, strict=True)
        self._state = states[-1]
        self.pose_count += len(rows)
        return OdometryRows.from_states(times, states)
