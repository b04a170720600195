"""Messages of topics as records of a log: samples of a node, wheel speeds, fixes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from hubodo.ingest.live.localizer import FixSample, horizontal_sigma
from hubodo.ingest.live.odometer import SpeedSample
from hubodo.ingest.node.log_times import LogTimeSequence
from hubodo.ingest.topic.port import TopicPort
from hubodo.log import ros2, topics
from hubodo.log.records import Columns, GnssFix, ImuBlock, ImuNoise, Sink
from hubodo.log.roles import recognise_wheel_joints
from hubodo.vehicle import Vehicle

Values = Mapping[str, Any]
TopicItem = ImuBlock | FixSample | SpeedSample
"""Content of a message that odometry and map use."""


class TopicHandler(Protocol):
    """Converts and logs the messages of one topic; stream: their name in `gap` events."""

    stream: str

    def handle(
        self, message_type: str, values: Values, t_ns: int, received_ns: int
    ) -> Sequence[TopicItem] | None:
        """Log a message and return what odometry and map use; None if its values cannot be used.

        t_ns: host time of its stamp; received_ns: host time of its arrival.
        """
        ...


class ImuHandler:
    """Logs `sensor_msgs/Imu` as the samples of a node."""

    stream = "ImuBatch"

    def __init__(self, node: str, sink: Sink, order: LogTimeSequence) -> None:
        """Start without samples; order: source of unique log times, shared by all nodes."""
        self.newest_block: ImuBlock | None = None
        self._node, self._sink, self._order = node, sink, order
        self._noise: tuple[float, float] | None = None

    def handle(
        self, message_type: str, values: Values, t_ns: int, received_ns: int
    ) -> Sequence[ImuBlock] | None:
        """Log a sample; see `TopicHandler`."""
        rates, forces = (_vector(values[name]) for name in ("angular_velocity", "linear_acceleration"))
        if not all(map(math.isfinite, (*rates, *forces))):
            return None
        self._update_noise(values)
        block = ImuBlock(
            self._node,
            np.array([rates]),
            np.array([forces]),
            None,
            received_ns,
            t_ns=np.array([t_ns], np.int64),
            t_log_ns=self._order.next_time(received_ns),
        )
        self._sink.write_record(block)
        self.newest_block = block
        return (block,)

    def _update_noise(self, values: Values) -> None:
        """Log the noise of the samples if the publisher states it; -1 and zeros mean unknown (REP 145)."""
        variances = [
            values[name][0] for name in ("angular_velocity_covariance", "linear_acceleration_covariance")
        ]
        if all(math.isfinite(variance) and variance > 0.0 for variance in variances):
            noise = math.sqrt(variances[0]), math.sqrt(variances[1])
            if noise != self._noise:
                self._noise = noise
                self._sink.write_record(ImuNoise(self._node, *noise))


class FixHandler:
    """Logs `sensor_msgs/NavSatFix`."""

    stream = "NavSatFix"

    def __init__(self, sink: Sink, order: LogTimeSequence) -> None:
        """Start without fixes; order: source of unique log times, shared by all nodes and receivers."""
        self.fixes = 0
        self.last_fix: GnssFix | None = None
        self._sink, self._order = sink, order

    def handle(
        self, message_type: str, values: Values, t_ns: int, received_ns: int
    ) -> Sequence[FixSample] | None:
        """Log a fix; see `TopicHandler`."""
        position = values["latitude"], values["longitude"], values["altitude"]
        status, covariance = values["status"]["status"], values["position_covariance"]
        if not all(map(math.isfinite, position)) or abs(position[0]) > 90.0 or abs(position[1]) > 360.0:
            return None
        variances = covariance[0], covariance[4], covariance[8]
        is_known = values["position_covariance_type"] > 0 and all(
            math.isfinite(variance) and variance >= 0.0 for variance in variances
        )
        east, north, up = map(math.sqrt, variances) if is_known else (0.0, 0.0, 0.0)
        fix = GnssFix(
            t_ns,
            self._order.next_time(received_ns),
            *position,
            (east, north, up) if is_known else None,
            status,
        )
        self._sink.write_record(fix)
        if status < 0:
            return ()
        self.fixes += 1
        self.last_fix = fix
        sigma = horizontal_sigma(variances[0], variances[1]) if is_known else None
        return (FixSample(t_ns, position[0], position[1], sigma),)


class WheelsHandler:
    """Logs surface speeds of the wheels, from joint rates times the radius or from a twist."""

    stream = topics.WHEELS

    def __init__(self, vehicle: Vehicle, joints: tuple[str, ...], sink: Sink, order: LogTimeSequence) -> None:
        """Start without speeds; joints: names of left and right joint, empty to recognise them.

        order: log times, shared with the samples of all nodes.
        """
        self._radius, self._half_track = vehicle.wheel_radius, 0.5 * vehicle.track_width
        self._joints, self._sink, self._order = joints, sink, order

    def handle(
        self, message_type: str, values: Values, t_ns: int, received_ns: int
    ) -> Sequence[TopicItem] | None:
        """Log the speeds; see `TopicHandler`. A message that lacks one of the wheels cannot be used."""
        if message_type == ros2.JOINT_STATE:
            speeds = self._joint_speeds(values)
        else:
            twist = values["twist"] if message_type == ros2.TWIST_STAMPED else values["twist"]["twist"]
            forward, turn = twist["linear"]["x"], twist["angular"]["z"] * self._half_track
            speeds = forward - turn, forward + turn
        if speeds is None or not all(map(math.isfinite, speeds)):
            return None
        columns = {"left": [speeds[0]], "right": [speeds[1]]}
        self._sink.write_record(Columns(topics.WHEELS, [t_ns], self._order.next_time(received_ns), columns))
        return (SpeedSample(t_ns, *speeds),)

    def _joint_speeds(self, values: Values) -> tuple[float, float] | None:
        rates = dict(zip(values["name"], values["velocity"], strict=False))
        left, right = self._joints or recognise_wheel_joints(rates) or ("", "")
        if left not in rates or right not in rates:
            return None
        return self._radius * rates[left], self._radius * rates[right]


def create_handler(
    port: TopicPort, sink: Sink, order: LogTimeSequence, vehicle: Vehicle | None
) -> TopicHandler:
    """Return the handler of a topic by its role."""
    if port.role == "gnss":
        return FixHandler(sink, order)
    if port.role == "wheels":
        if vehicle is None:
            raise ValueError("wheel speeds need the wheel radius of a vehicle")
        return WheelsHandler(vehicle, port.joints, sink, order)
    return ImuHandler(port.label, sink, order)


def _vector(value: Values) -> tuple[float, float, float]:
    return value["x"], value["y"], value["z"]
