"""The interface of the log writer that ingest uses."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from numpy.typing import ArrayLike

from hubodo.log import topics
from hubodo.recording import Event


class Sink(Protocol):
    """A log writer. Times in ns: t_pub_ns: measurement; t_log_ns: reception; otherwise as `LogWriter`."""

    def write_imu(
        self, node: str, t_pub_ns: ArrayLike, t_log_ns: ArrayLike, gyro: ArrayLike, accel: ArrayLike
    ) -> None: ...

    def write_temperature(
        self, node: str, t_pub_ns: ArrayLike, t_log_ns: ArrayLike, temperature: ArrayLike
    ) -> None: ...

    def write_battery(
        self,
        node: str,
        t_pub_ns: ArrayLike,
        t_log_ns: ArrayLike,
        voltage: ArrayLike,
        charge: ArrayLike = ...,
    ) -> None: ...

    def write_magnetic_field(
        self, node: str, t_pub_ns: ArrayLike, t_log_ns: ArrayLike, field: ArrayLike
    ) -> None: ...

    def write_bias_filter(
        self, node: str, t_pub_ns: ArrayLike, t_log_ns: ArrayLike, table: Mapping[str, ArrayLike]
    ) -> None: ...

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
    ) -> None: ...

    def write_transform(
        self,
        t_pub_ns: ArrayLike,
        t_log_ns: ArrayLike,
        position: ArrayLike,
        heading: ArrayLike,
        *,
        frame: str = "odom",
        child_frame: str = "base_link",
    ) -> None: ...

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
    ) -> None: ...

    def write_columns(
        self, name: str, t_pub_ns: ArrayLike, t_log_ns: ArrayLike, table: Mapping[str, ArrayLike]
    ) -> None: ...

    def write_raw_frame(self, link: str, t_log_ns: int, frame: bytes) -> None: ...

    def write_clock_request(self, link: str, t_ns: int, token: bytes) -> None: ...

    def write_event(self, event: Event, t_log_ns: int | None = None) -> None: ...

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None: ...

    def add_channel(
        self, topic: str, schema: str, schema_encoding: str, definition: bytes, encoding: str
    ) -> int: ...

    def write(self, channel: int, t_log_ns: int, t_pub_ns: int, payload: bytes) -> None: ...
