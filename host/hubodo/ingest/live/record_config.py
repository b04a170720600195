"""Table `[record]` of hubodo.toml: settings of a recording with their meaning and bounds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from hubodo.errors import ConfigError
from hubodo.ingest.link.topic_name import is_topic
from hubodo.log.disk_space import BYTES_PER_MB, RotationRules
from hubodo.settings_table import check_bounds, setting
from hubodo.toml_file import check_known_keys, load_toml, read_table
from hubowire.budget import CONSOLE_BAUD, UART_BAUD

CONFIG_TABLES = ("record", "web", "ros2")
"""Tables of hubodo.toml."""

MAX_BAUD = 50_000_000
"""Upper bound of baud rates, which no serial port reaches."""


@dataclass(frozen=True, slots=True)
class RecordConfig:
    """Table ``[record]`` of hubodo.toml: defaults of `hubodo record`, overridden by the command line.

    Each setting is written here alone: file, check, example and command line take it from its field.
    """

    ports: tuple[str, ...] = setting(
        (),
        "Nodes: [NAME=]/dev/..., a USB serial number, socket://HOST:PORT, udp://HOST:PORT (to listen on), "
        "ble://NAME or ros2:/TOPIC.",
        example=("left=/dev/hubodo/E66058388366A231", "right=/dev/hubodo/E66058388355B142"),
        metavar="PORT",
    )
    output: str | None = setting(
        None,
        "Log to write, which must not exist, or a folder in which logs are named by UTC time.",
        example="logs",
        metavar="FILE.mcap",
    )
    vehicle: str | None = setting(
        None, "Geometry of the vehicle: enables live odometry.", example="vehicle.toml", metavar="TOML"
    )
    calibration: str | None = setting(
        None,
        "Calibration of the live odometry; the log holds the raw samples.",
        example="calibration.toml",
        metavar="TOML",
    )
    key_file: str | None = setting(
        None,
        "Keys of nodes on UDP or Bluetooth, written by `hubodo flash --key-file`; messages without a "
        "valid key are rejected, by the nodes too.",
        example="keys.toml",
        metavar="TOML",
    )
    insecure_udp: bool = setting(
        False,
        "Accept UDP without keys from other machines: anybody on the network can then send samples and "
        "commands (not needed for 127.0.0.1).",
        example=True,
    )
    insecure_ble: bool = setting(
        False,
        "Accept nodes by Bluetooth without keys: anybody nearby can then pose as a node, or send commands.",
        example=True,
    )
    gnss: str | None = setting(
        None,
        "Port of a GNSS receiver with NMEA output; with a vehicle it places the odometry on the map.",
        example="/dev/ttyUSB0",
        metavar="PORT",
    )
    gnss_baud: int = setting(
        9600, "Baud rate of the GNSS receiver.", above=0, at_most=MAX_BAUD, metavar="BAUD"
    )
    baud: int = setting(
        UART_BAUD,
        f"Baud rate of the nodes' serial ports; {CONSOLE_BAUD} for an ESP32 on its converter, any on USB.",
        above=0,
        at_most=MAX_BAUD,
        metavar="BAUD",
    )
    wait: bool = setting(
        False, "Wait for ports that are missing or busy, and for free disk space.", example=True
    )
    duration: float | None = setting(
        None,
        "Duration, s; without it the recording continues until it is stopped.",
        example=3600.0,
        above=0,
        metavar="S",
    )
    compression: Literal["zstd", "lz4", "none"] = setting(
        "zstd", 'Compression of the log: "zstd", "lz4" or "none".'
    )
    odometry_rate_hz: float | None = setting(
        None, "Maximum rate of poses, Hz; without it one per sample.", example=50.0, above=0
    )
    clock_request_period: float = setting(1.0, "s between two clock requests to a node.", above=0)
    time_scale: float = setting(
        1.0,
        "For emulated nodes slower than real time: seconds of real time per second of the log.",
        above=0,
        metavar="N",
    )
    rotate_after: float | None = setting(
        None,
        "Time after which a new log is started, s; each log is complete in itself.",
        example=3600.0,
        above=0,
        metavar="S",
    )
    rotate_at_mb: float | None = setting(
        None, "Size at which a new log is started, MB.", example=500.0, above=0, metavar="MB"
    )
    disk_budget_mb: float | None = setting(
        None,
        "Maximum size of all logs of this name, MB; the oldest is removed first; without it none is removed.",
        example=20_000.0,
        above=0,
        metavar="MB",
    )
    disk_reserve_mb: float = setting(
        20.0,
        "Space that stays free on the disk, MB: recording pauses below it, and resumes above it.",
        at_least=0,
    )
    metrics: str | None = setting(
        None,
        "Address on which /metrics for Prometheus and /healthz are served.",
        example="127.0.0.1:9464",
        metavar="HOST:PORT",
    )
    mavlink: str | None = setting(
        None,
        "Address to which the odometry is sent as MAVLink (ODOMETRY, WHEEL_DISTANCE), for ArduPilot and PX4.",
        example="udpout:127.0.0.1:14550",
        metavar="udpout:HOST:PORT",
    )
    quiet: bool = setting(False, "No live view; notices are still shown.", example=True)
    log_format: Literal["text", "json"] = setting(
        "text", 'Format of messages on stderr: "text", or "json", one object per line, for services.'
    )

    @property
    def insecure_kinds(self) -> tuple[str, ...]:
        """Kinds of ports that accept nodes without keys."""
        return (*(("udp",) if self.insecure_udp else ()), *(("ble",) if self.insecure_ble else ()))

    @property
    def key_path(self) -> Path | None:
        """Path of the key file; None without one."""
        return None if self.key_file is None else Path(self.key_file)

    def topic_ports(self) -> list[str]:
        """Return the ports that are ROS 2 topics."""
        return [text for text in (*self.ports, self.gnss) if text is not None and is_topic(text)]

    def rules(self) -> RotationRules:
        """Return the rules for rotation of logs and disk space."""

        def size(mb: float | None) -> int | None:
            return None if mb is None else int(mb * BYTES_PER_MB)

        return RotationRules(
            self.rotate_after,
            size(self.rotate_at_mb),
            size(self.disk_budget_mb),
            int(self.disk_reserve_mb * BYTES_PER_MB),
        )


def check_record_config(config: RecordConfig, where: Callable[[str], str]) -> None:
    """Raise ConfigError for settings out of bounds or in contradiction; where: name of a setting."""
    check_bounds(config, where)
    if config.disk_budget_mb is not None and config.rotate_after is None and config.rotate_at_mb is None:
        raise ConfigError(
            f"{where('disk_budget_mb')} {config.disk_budget_mb:g}: only closed logs are removed, so set "
            f"{where('rotate_at_mb')} or {where('rotate_after')} as well"
        )
    if config.disk_budget_mb is not None and config.disk_budget_mb < 2 * (config.rotate_at_mb or 0.0):
        raise ConfigError(
            f"{where('disk_budget_mb')} {config.disk_budget_mb:g}: must hold two logs of "
            f"{where('rotate_at_mb')} {config.rotate_at_mb:g}"
        )


def load_record_config(path: Path) -> RecordConfig:
    """Read hubodo.toml.

    Paths in it (output, vehicle, calibration, key_file) are relative to the file. Raises ConfigError at the
    first key that is unknown, of the wrong type or out of bounds.
    """
    table = load_toml(path)
    check_known_keys(table, CONFIG_TABLES, str(path))
    config = read_table(table.get("record", {}), RecordConfig, f"{path}: [record]")
    if config.key_file is not None:
        config = replace(config, key_file=str(path.parent / config.key_file))
    check_record_config(config, lambda key: f"{path}: [record] {key} =")
    return config
