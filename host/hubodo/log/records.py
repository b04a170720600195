"""Records of a hubodo log: one class per kind, which writes itself to a `LogWriter`.

A further kind is one class here and one line in `LogRecord`. Times are host times in ns: `t_ns` of
measurement, `t_log_ns` of reception.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hubodo.arrays import Array
from hubodo.log import topics
from hubodo.log.log_writer import LogWriter
from hubodo.recording import HIGH_G_COLUMNS, Event

Times = NDArray[np.int64]


def _no_times() -> Times:
    return np.empty(0, np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class ImuBlock:
    """Consecutive samples of one node, received together: the same object from decoder to log and filter.

    Attributes
    ----------
    gyro, accel
        (N, 3) rad/s and (N, 3) m/s² specific force, uncalibrated, node axes.
    temperature
        Temperature of the sensor, °C; None if unknown.
    received_ns
        Host time of arrival.
    device_ns
        (N,) unwrapped device time; empty in a block read from a log.
    t_ns
        (N,) host time; empty until the node's clock is synchronised.
    power_on_ns
        Host time of the node's power-on; None if unknown.
    t_log_ns
        Host time at which the log records the block.
    supply
        Newest supply voltage before the samples, V; None if unknown.
    beyond_range
        (N,) True where a second accelerometer replaced saturated values for the odometry; None if nowhere.
    """

    node: str
    gyro: Array
    accel: Array
    temperature: float | None
    received_ns: int
    device_ns: Times = field(default_factory=_no_times)
    t_ns: Times = field(default_factory=_no_times)
    t_log_ns: int = 0
    power_on_ns: int | None = None
    supply: float | None = None
    beyond_range: NDArray[np.bool_] | None = None

    def write_to(self, log: LogWriter) -> None:
        """Write samples and temperature."""
        log.write_imu(self.node, self.t_ns, self.t_log_ns, self.gyro, self.accel)
        if self.temperature is not None:
            log.write_temperature(self.node, self.t_ns[:1], self.t_log_ns, self.temperature)


@dataclass(frozen=True, slots=True, eq=False)
class HighGSamples:
    """Samples of a node's second accelerometer; accel: (N, 3) m/s², uncalibrated, node axes."""

    node: str
    t_ns: Times
    t_log_ns: int
    accel: Array

    def write_to(self, log: LogWriter) -> None:
        """Write the samples."""
        columns = dict(zip(HIGH_G_COLUMNS[1:], self.accel.T, strict=True))
        log.write_columns(topics.HIGH_G_PREFIX + self.node, self.t_ns, self.t_log_ns, columns)


@dataclass(frozen=True, slots=True, eq=False)
class ImuRun:
    """Consecutive blocks of one node as arrays, for decoding many frames at once.

    gyro, accel, device_ns, t_ns: all N samples, as in `ImuBlock`. first_rows: (B,) first sample of each
    block; temperature: (B,) °C; received_ns, t_log_ns: (B,).
    """

    node: str
    gyro: Array
    accel: Array
    temperature: Array
    received_ns: Times
    device_ns: Times
    first_rows: Times
    t_ns: Times = field(default_factory=_no_times)
    t_log_ns: Times = field(default_factory=_no_times)

    def split(self) -> Iterator[ImuBlock]:
        """Yield the blocks one by one, without host times."""
        edges = [*self.first_rows.tolist(), len(self.device_ns)]
        block_values = zip(self.temperature.tolist(), self.received_ns.tolist(), strict=True)
        for (start, end), (temperature, received_ns) in zip(pairwise(edges), block_values, strict=True):
            rows = slice(start, end)
            yield ImuBlock(
                self.node, self.gyro[rows], self.accel[rows], temperature, received_ns, self.device_ns[rows]
            )

    def write_to(self, log: LogWriter) -> None:
        """Write samples and temperatures."""
        counts = np.diff(self.first_rows, append=len(self.t_ns))
        log.write_imu(self.node, self.t_ns, np.repeat(self.t_log_ns, counts), self.gyro, self.accel)
        log.write_temperature(self.node, self.t_ns[self.first_rows], self.t_log_ns, self.temperature)


@dataclass(frozen=True, slots=True)
class ImuNoise:
    """White noise of the samples of a node, 1 sigma per sample; gyro: rad/s; accel: m/s²."""

    node: str
    gyro: float
    accel: float

    def write_to(self, log: LogWriter) -> None:
        """Set the covariances of the samples that follow."""
        log.set_imu_noise(self.node, self.gyro, self.accel)


@dataclass(frozen=True, slots=True, eq=False)
class Battery:
    """Supply of a node; voltage: V; charge: 0 to 1, NaN if unknown."""

    node: str
    t_ns: ArrayLike
    t_log_ns: int
    voltage: float
    charge: float

    def write_to(self, log: LogWriter) -> None:
        """Write the supply."""
        log.write_battery(self.node, self.t_ns, self.t_log_ns, self.voltage, self.charge)


@dataclass(frozen=True, slots=True, eq=False)
class MagneticField:
    """Magnetic field at a node; field: (n, 3) T, node axes."""

    node: str
    t_ns: ArrayLike
    t_log_ns: int
    field: ArrayLike

    def write_to(self, log: LogWriter) -> None:
        """Write the field."""
        log.write_magnetic_field(self.node, self.t_ns, self.t_log_ns, self.field)


@dataclass(frozen=True, slots=True, eq=False)
class BiasFilterRow:
    """Report of a node's own bias filter, by column of `BIAS_FILTER_COLUMNS`, rad/s."""

    node: str
    t_ns: ArrayLike
    t_log_ns: int
    columns: Mapping[str, float]

    def write_to(self, log: LogWriter) -> None:
        """Write the row."""
        log.write_bias_filter(self.node, self.t_ns, self.t_log_ns, self.columns)


@dataclass(frozen=True, slots=True, eq=False)
class Odometry:
    """Planar odometry.

    t_ns: (n,); position: (n, 2) m; heading: (n,) rad; speed: (n,) m/s; yaw_rate: (n,) rad/s; pose_covariance:
    (n, 3, 3) of x, y, heading; twist_covariance: (n, 2, 2) of speed, yaw rate, None if unknown.
    """

    t_ns: Times
    t_log_ns: int
    position: Array
    heading: Array
    speed: Array
    yaw_rate: Array
    pose_covariance: Array | None = None
    twist_covariance: Array | None = None
    topic: str = topics.ODOM
    frame: str = "odom"

    def write_to(self, log: LogWriter) -> None:
        """Write the rows."""
        log.write_odometry(
            self.t_ns,
            self.t_log_ns,
            self.position,
            self.heading,
            self.speed,
            self.yaw_rate,
            pose_covariance=self.pose_covariance,
            twist_covariance=self.twist_covariance,
            topic=self.topic,
            frame=self.frame,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Transform:
    """Planar transforms on /tf; position: (n, 2) m; heading: (n,) rad."""

    t_ns: Times
    t_log_ns: int
    position: Array
    heading: Array
    frame: str = "odom"
    child_frame: str = "base_link"

    def write_to(self, log: LogWriter) -> None:
        """Write the transforms."""
        log.write_transform(
            self.t_ns,
            self.t_log_ns,
            self.position,
            self.heading,
            frame=self.frame,
            child_frame=self.child_frame,
        )


@dataclass(frozen=True, slots=True)
class GnssFix:
    """GNSS position; altitude: m; sigma: m of east, north, up, None if unknown; status: NavSatStatus."""

    t_ns: int
    t_log_ns: int
    latitude_deg: float
    longitude_deg: float
    altitude: float
    sigma: tuple[float, float, float] | None
    status: int

    def write_to(self, log: LogWriter) -> None:
        """Write the fix."""
        log.write_gnss_fix(
            self.t_ns,
            self.t_log_ns,
            self.latitude_deg,
            self.longitude_deg,
            self.altitude,
            sigma=None if self.sigma is None else [self.sigma],
            status=self.status,
        )


@dataclass(frozen=True, slots=True)
class NmeaBytes:
    """Bytes of a GNSS receiver as received."""

    t_log_ns: int
    data: bytes

    def write_to(self, log: LogWriter) -> None:
        """Write the bytes."""
        channel = log.channel_of(topics.NMEA) or log.add_channel(topics.NMEA, "", "", b"", "nmea")
        log.write(channel, self.t_log_ns, self.t_log_ns, self.data)


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """Named float64 columns without a ROS type."""

    name: str
    t_ns: ArrayLike
    t_log_ns: int
    columns: Mapping[str, ArrayLike]

    def write_to(self, log: LogWriter) -> None:
        """Write the columns."""
        log.write_columns(self.name, self.t_ns, self.t_log_ns, self.columns)


@dataclass(frozen=True, slots=True)
class RawFrame:
    """One frame of a link as received, before decoding; link: label and suffix of its topic."""

    link: str
    t_log_ns: int
    frame: bytes

    def write_to(self, log: LogWriter) -> None:
        """Write the frame."""
        log.write_raw_frame(self.link, self.t_log_ns, self.frame)


@dataclass(frozen=True, slots=True)
class ClockRequest:
    """Token of a clock request at the time at which it was sent."""

    link: str
    t_log_ns: int
    token: bytes

    def write_to(self, log: LogWriter) -> None:
        """Write the token."""
        log.write_clock_request(self.link, self.t_log_ns, self.token)


@dataclass(frozen=True, slots=True)
class EventRecord:
    """An event; t_log_ns: time of its repetition in a later log, None for the time of the event."""

    event: Event
    t_log_ns: int | None = None

    def write_to(self, log: LogWriter) -> None:
        """Write the event."""
        log.write_event(self.event, self.t_log_ns)


@dataclass(frozen=True, slots=True)
class Metadata:
    """A metadata record of the log, which replaces an earlier one of the same name."""

    name: str
    values: Mapping[str, str]

    def write_to(self, log: LogWriter) -> None:
        """Write the metadata."""
        log.add_metadata(self.name, self.values)


NodeSamples = ImuBlock | HighGSamples
"""Samples of a node that the odometry processes."""

LogRecord = (
    ImuBlock
    | HighGSamples
    | ImuRun
    | ImuNoise
    | Battery
    | MagneticField
    | BiasFilterRow
    | Odometry
    | Transform
    | GnssFix
    | NmeaBytes
    | Columns
    | RawFrame
    | ClockRequest
    | EventRecord
    | Metadata
)


class Sink(Protocol):
    """A destination of log records."""

    def write_record(self, record: LogRecord, /) -> None:
        """Write one record."""
        ...


def stream_key(record: LogRecord) -> tuple[object, ...]:
    """Return the kind of a record and its names (node, link, topic, frame), equal for one channel."""
    values = (getattr(record, item.name) for item in fields(record))
    return (type(record), *(value for value in values if isinstance(value, str)))
