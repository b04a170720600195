"""Write the typed messages of a hubodo log.

Times are (n,) ns or one int on the host clock: `t_pub_ns` of measurement, `t_log_ns` of receipt.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hubodo.log import cdr_layouts, ros2, topics
from hubodo.log.chunk_writer import ChunkWriter
from hubodo.log.frames import GNSS_FRAME, sensor_frames
from hubodo.log.hubodo_messages import encode_bytes_message, encode_string_message
from hubodo.log.message_records import RowBuffer
from hubodo.log.ros2 import UNKNOWN_VARIANCE
from hubodo.recording import Event
from hubodo.safe_text import json_text
from hubodo.units import NS_PER_S
from hubodo.vehicle import Vehicle


class WritableRecord(Protocol):
    """A record that writes itself with the methods of a `LogWriter`; `records.py` holds all kinds."""

    def write_to(self, log: LogWriter, /) -> None:
        """Write the record."""
        ...


class LogWriter(ChunkWriter):
    """A writer of hubodo logs; a context manager for one thread. Parameters as `ChunkWriter`."""

    _static_frames: tuple[RowBuffer, dict[str, ArrayLike]] | None = None
    _imu_noise: Mapping[str, tuple[float, float]] = {}

    def set_imu_noise(self, node: str, gyro: float, accel: float) -> None:
        """Set the covariances of the inertial samples of a node from now on. 1 sigma, rad/s and m/s²."""
        self._imu_noise = {**self._imu_noise, node: (gyro, accel)}
        stream = self._streams.get(node + "/imu")
        if stream is not None:
            self._encode_pending_rows(stream)
            _fill_imu_covariances(stream, gyro, accel)

    def write_record(self, record: WritableRecord, /) -> None:
        """Write a record of any kind."""
        record.write_to(self)

    def channel_of(self, topic: str) -> int | None:
        """Return the channel of a topic; None before it was announced."""
        return self._channels.get(topic)

    def write_imu(
        self, node: str, t_pub_ns: ArrayLike, t_log_ns: ArrayLike, gyro: ArrayLike, accel: ArrayLike
    ) -> None:
        """Write inertial samples, node frame. gyro: (n, 3) rad/s; accel: (n, 3) m/s² specific force."""
        stream = self._streams.get(node + "/imu") or self._open_imu_stream(node)
        self.write_rows(stream, t_pub_ns, t_log_ns, {"angular_velocity": gyro, "linear_acceleration": accel})

    def write_temperature(
        self, node: str, t_pub_ns: ArrayLike, t_log_ns: ArrayLike, temperature: ArrayLike
    ) -> None:
        """Write the temperature of a node's sensor. temperature: (n,) °C."""
        stream = self._streams.get(node + "/temperature") or self._open_stream(
            node + "/temperature", topics.temperature_topic(node), ros2.TEMPERATURE, node
        )
        self.write_rows(stream, t_pub_ns, t_log_ns, {"temperature": temperature})

    def write_battery(
        self,
        node: str,
        t_pub_ns: ArrayLike,
        t_log_ns: ArrayLike,
        voltage: ArrayLike,
        charge: ArrayLike = np.nan,
    ) -> None:
        """Write the supply of a node. voltage: (n,) V; charge: (n,) 0 to 1, NaN if unknown."""
        stream = self._streams.get(node + "/battery") or self._open_battery_stream(node)
        self.write_rows(stream, t_pub_ns, t_log_ns, {"voltage": voltage, "percentage": charge})

    def write_magnetic_field(
        self, node: str, t_pub_ns: ArrayLike, t_log_ns: ArrayLike, field: ArrayLike
    ) -> None:
        """Write magnetometer samples of a node. field: (n, 3) tesla, node frame."""
        stream = self._streams.get(node + "/mag") or self._open_stream(
            node + "/mag", topics.magnetic_field_topic(node), ros2.MAGNETIC_FIELD, node
        )
        self.write_rows(stream, t_pub_ns, t_log_ns, {"magnetic_field": field})

    def write_odometry(
        self,
        t_pub_ns: ArrayLike,
        t_log_ns: ArrayLike,
        position: ArrayLike,
        heading: ArrayLike,
        speed: ArrayLike,
        yaw_rate: ArrayLike,
        *,
        pose_covariance: ArrayLike | None = None,
        twist_covariance: ArrayLike | None = None,
        topic: str = topics.ODOM,
        frame: str = "odom",
        child_frame: str = "base_link",
    ) -> None:
        """Write planar odometry. position: (n, 2) m; heading (n,) rad; speed (n,) m/s; yaw_rate (n,) rad/s.

        pose_covariance: (n, 3, 3) over x, y, heading; twist_covariance: (n, 2, 2) over speed, yaw rate. Where
        one is given, the other coordinates have the variance UNKNOWN_VARIANCE; all zeros mean unknown.
        """
        stream = self._streams.get(topic) or self._open_stream(
            topic, topic, ros2.ODOMETRY, frame, child_frame
        )
        half = np.atleast_1d(np.asarray(heading, np.float64)) / 2
        values: dict[str, ArrayLike] = {
            "pose.pose.position": _pad_position(position, len(half)),
            "pose.pose.orientation.z": np.sin(half),
            "pose.pose.orientation.w": np.cos(half),
            "twist.twist.linear.x": speed,
            "twist.twist.angular.z": yaw_rate,
            "pose.covariance": _expand_covariance(pose_covariance, len(half), (0, 1, 5)),
            "twist.covariance": _expand_covariance(twist_covariance, len(half), (0, 5)),
        }
        self.write_rows(stream, t_pub_ns, t_log_ns, values)

    def write_transform(
        self,
        t_pub_ns: ArrayLike,
        t_log_ns: ArrayLike,
        position: ArrayLike,
        heading: ArrayLike,
        *,
        frame: str = "odom",
        child_frame: str = "base_link",
    ) -> None:
        """Write a planar transform to /tf. position: (n, 2) m; heading: (n,) rad."""
        stream = self._streams.get(f"tf {frame} {child_frame}") or self._open_stream(
            f"tf {frame} {child_frame}", topics.TF, ros2.TF, frame, child_frame
        )
        half = np.atleast_1d(np.asarray(heading, np.float64)) / 2
        values: dict[str, ArrayLike] = {
            "transforms[0].transform.translation": _pad_position(position, len(half)),
            "transforms[0].transform.rotation.z": np.sin(half),
            "transforms[0].transform.rotation.w": np.cos(half),
        }
        self.write_rows(stream, t_pub_ns, t_log_ns, values)

    def write_static_frames(self, t_ns: int, vehicle: Vehicle) -> None:
        """Write the frames of the vehicle's nodes and antenna to /tf_static as one message."""
        frames = sensor_frames(vehicle)
        if not frames:
            return
        texts: dict[str, bytes] = {}
        values: dict[str, ArrayLike] = {}
        for i, frame in enumerate(frames):
            part = f"transforms[{i}]."
            texts |= {part + "header.frame_id": b"base_link", part + "child_frame_id": frame.name.encode()}
            values[part + "transform.translation"] = np.array([frame.position])
            values[part + "transform.rotation"] = np.array([frame.rotation])
        layout = cdr_layouts.cdr_layout(ros2.TF, texts, {"transforms": len(frames)})
        channel = self.add_ros2_channel(topics.TF_STATIC, ros2.TF)
        self._static_frames = RowBuffer(channel, layout, ""), values
        self.repeat_static_frames(t_ns)

    def repeat_static_frames(self, t_ns: int) -> None:
        """Write the static frames again, at the start of another file; does nothing if there are none."""
        if self._static_frames is None:
            return
        (stream, values), (seconds, nanoseconds) = self._static_frames, divmod(t_ns, NS_PER_S)
        count = len(values) // 2
        stamps: dict[str, ArrayLike] = {
            f"transforms[{i}].header.stamp.{name}": value
            for i in range(count)
            for name, value in (("sec", seconds), ("nanosec", nanoseconds))
        }
        self.write_rows(stream, t_ns, t_ns, {**values, **stamps})

    def write_gnss_fix(
        self,
        t_pub_ns: ArrayLike,
        t_log_ns: ArrayLike,
        latitude_deg: ArrayLike,
        longitude_deg: ArrayLike,
        altitude: ArrayLike,
        *,
        sigma: ArrayLike | None = None,
        status: ArrayLike = 0,
        frame: str = GNSS_FRAME,
    ) -> None:
        """Write GNSS positions. altitude: (n,) m; sigma: (n, 3) m of east, north, up, or None if unknown.

        status: (n,) as in NavSatStatus (-1 no fix, 0 fix, 1 SBAS, 2 GBAS/RTK).
        """
        stream = self._streams.get(topics.GNSS_FIX) or self._open_stream(
            topics.GNSS_FIX, topics.GNSS_FIX, ros2.NAV_SAT_FIX, frame
        )
        count = np.size(latitude_deg)
        covariance = np.zeros((count, 9))
        if sigma is not None:
            covariance[:, [0, 4, 8]] = np.square(np.asarray(sigma, np.float64)).reshape(count, 3)
        values: dict[str, ArrayLike] = {
            "latitude": latitude_deg,
            "longitude": longitude_deg,
            "altitude": altitude,
            "position_covariance": covariance,
            "position_covariance_type": 0 if sigma is None else 2,
            "status.status": status,
            "status.service": 1,
        }
        self.write_rows(stream, t_pub_ns, t_log_ns, values)

    def write_columns(
        self, name: str, t_pub_ns: ArrayLike, t_log_ns: ArrayLike, table: Mapping[str, ArrayLike]
    ) -> None:
        """Write float64 columns without a ROS type, lossless. table: column -> (n,)."""
        self._write_float_rows(topics.COLUMNS_PREFIX + name, t_pub_ns, t_log_ns, table)

    def write_bias_filter(
        self, node: str, t_pub_ns: ArrayLike, t_log_ns: ArrayLike, table: Mapping[str, ArrayLike]
    ) -> None:
        """Write reports of a node's gyro bias filter.

        table: column of `BIAS_FILTER_COLUMNS`, except `t` -> (n,), rad/s.
        """
        self._write_float_rows(topics.bias_filter_topic(node), t_pub_ns, t_log_ns, table)

    def _write_float_rows(
        self, topic: str, t_pub_ns: ArrayLike, t_log_ns: ArrayLike, table: Mapping[str, ArrayLike]
    ) -> None:
        stream = self._streams.get(topic)
        if stream is None:
            metadata = {"columns": json_text(list(table))}
            channel = self.add_ros2_channel(topic, ros2.FLOAT64_ARRAY, metadata)
            stream = self._streams[topic] = RowBuffer(channel, cdr_layouts.columns_layout(list(table)), "")
        rows = np.column_stack([np.asarray(values, np.float64) for values in table.values()])
        self.write_rows(stream, t_pub_ns, t_log_ns, {"data": rows})

    def write_raw_frame(self, link: str, t_log_ns: int, frame: bytes) -> None:
        """Write one frame as received from a link, before decoding."""
        channel = self._channels.get(topics.RAW_PREFIX + link)
        if channel is None:
            channel = self.add_ros2_channel(topics.RAW_PREFIX + link, ros2.UINT8_ARRAY)
        self.write(channel, t_log_ns, t_log_ns, encode_bytes_message(frame))

    def write_clock_request(self, link: str, t_ns: int, token: bytes) -> None:
        """Write the token of a clock request, at the time at which it was sent to a node."""
        topic = topics.CLOCK_REQUEST_PREFIX + link
        channel = self._channels.get(topic)
        if channel is None:
            channel = self.add_ros2_channel(topic, ros2.UINT8_ARRAY)
        self.write(channel, t_ns, t_ns, encode_bytes_message(token))

    def write_event(self, event: Event, t_log_ns: int | None = None) -> None:
        """Write an event and flush at once, because events are rare and explain what follows.

        t_log_ns: log time of an event from before the start of this log; by default the event's time.
        """
        channel = self._channels.get(topics.EVENTS)
        if channel is None:
            channel = self.add_ros2_channel(
                topics.EVENTS, ros2.STRING, {"json_schema": topics.EVENT_JSON_SCHEMA}
            )
        body = {
            "t_ns": event.t_ns,
            "kind": event.kind,
            "source": event.source,
            "text": event.text,
            "data": dict(event.data),
        }
        t_log_ns = event.t_ns if t_log_ns is None else t_log_ns
        self.write(channel, t_log_ns, t_log_ns, encode_string_message(json_text(body)))
        self.flush()

    def _open_stream(self, key: str, topic: str, schema: str, frame: str, child: str = "") -> RowBuffer:
        channel = self._channels.get(topic)
        if channel is None:
            channel = self.add_ros2_channel(topic, schema)
        stamp = "transforms[0].header." if schema == ros2.TF else "header."
        stream = self._streams[key] = RowBuffer(
            channel, cdr_layouts.stamped_layout(schema, frame, child), stamp
        )
        return stream

    def _open_imu_stream(self, node: str) -> RowBuffer:
        stream = self._open_stream(node + "/imu", topics.imu_topic(node), ros2.IMU, node)
        # Orientation is not measured: sensor_msgs marks this by -1 in the first element of its covariance.
        stream.field_view("orientation_covariance")[:, 0] = -1
        if node in self._imu_noise:
            _fill_imu_covariances(stream, *self._imu_noise[node])
        return stream

    def _open_battery_stream(self, node: str) -> RowBuffer:
        stream = self._open_stream(node + "/battery", topics.battery_topic(node), ros2.BATTERY, node)
        # Unknown values: 0 for status, health and technology, NaN for measured quantities.
        for unknown in ("temperature", "current", "charge", "capacity", "design_capacity"):
            stream.field_view(unknown)[:] = np.nan
        stream.field_view("present")[:] = True
        return stream


def _fill_imu_covariances(stream: RowBuffer, gyro: float, accel: float) -> None:
    """Set the covariances of all rows; without a known noise they stay 0, which means unknown."""
    for field, sigma in (("angular_velocity", gyro), ("linear_acceleration", accel)):
        stream.field_view(f"{field}_covariance")[:, [0, 4, 8]] = sigma**2


def _pad_position(position: ArrayLike, count: int) -> NDArray[np.float64]:
    padded = np.zeros((count, 3))
    padded[:, :2] = position
    return padded


def _expand_covariance(
    covariance: ArrayLike | None, count: int, axes: tuple[int, ...]
) -> NDArray[np.float64]:
    spread = np.zeros((count, 6, 6))
    if covariance is not None:
        # Zero would mean that z, roll and pitch are exact.
        spread[:, range(6), range(6)] = UNKNOWN_VARIANCE
        spread[:, np.array(axes)[:, None], np.array(axes)] = covariance
    return spread.reshape(count, 36)
