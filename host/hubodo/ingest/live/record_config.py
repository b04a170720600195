"""`[record]` of hubodo.toml: defaults of a recording, their meaning and their bounds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from hubodo.errors import ConfigError
from hubodo.log.disk_space import BYTES_PER_MB
from hubodo.log.log_series import RotationRules
from hubodo.settings_table import check_bounds, setting
from hubodo.toml_file import check_known_keys, load_toml, read_table
from hubowire.budget import CONSOLE_BAUD, UART_BAUD

TABLES = ("record", "web")
"""Of hubodo.toml."""


@dataclass(frozen=True, slots=True)
class RecordConfig:
    """``[record]`` of hubodo.toml: defaults for `hubodo record`; the command line goes before them."""

    ports: tuple[str, ...] = setting(
        (),
        "Nodes: [NAME=]/dev/..., a USB serial number, socket://HOST:PORT or udp://HOST:PORT (to listen on).",
        example=("left=/dev/hubodo/E66058388366A231", "right=/dev/hubodo/E66058388355B142"),
    )
    output: str | None = setting(
        None,
        "The log, or a folder in which logs are named by UTC time. Paths in this file are relative to it.",
        example="logs",
    )
    vehicle: str | None = setting(
        None, "Geometry of the vehicle: switches live odometry on.", example="vehicle.toml"
    )
    calibration: str | None = setting(
        None, "Applied to what the odometry gets; the log keeps the raw samples.", example="calibration.toml"
    )
    key_file: str | None = setting(
        None,
        "Keys of nodes on UDP, as `hubodo flash --key-file` wrote it: nobody else is heard.",
        example="keys.toml",
    )
    insecure_udp: bool = setting(
        False,
        "UDP without keys from other machines too: anybody on the network can send samples.",
        example=True,
    )
    gnss: str | None = setting(None, "Port of a GNSS receiver that speaks NMEA.", example="/dev/ttyUSB0")
    gnss_baud: int = setting(9600, "Of the receiver's serial port.", above=0)
    baud: int = setting(
        UART_BAUD,
        f"Of the nodes' serial ports; {CONSOLE_BAUD} for an ESP32 on its USB converter; USB does not care.",
        above=0,
    )
    wait: bool = setting(
        False, "Wait for ports that are not there yet, or busy, and for room on the disk.", example=True
    )
    duration: float | None = setting(
        None, "s; without it recording goes on until it is stopped.", example=3600.0, above=0
    )
    compression: Literal["zstd", "lz4", "none"] = setting("zstd", 'Of the log: "zstd", "lz4" or "none".')
    odometry_rate_hz: float | None = setting(
        None, "Poses a second at most, Hz; without it one for every sample.", example=50.0, above=0
    )
    clock_request_period: float = setting(1.0, "s between two questions for a node's clock.", above=0)
    time_scale: float = setting(
        1.0, "For emulated nodes slower than real time: a second of the log takes so many seconds.", above=0
    )
    rotate_after: float | None = setting(
        None, "s after which another log begins; each is whole by itself.", example=3600.0, above=0
    )
    rotate_at_mb: float | None = setting(
        None, "Size at which another log begins, MB.", example=500.0, above=0
    )
    disk_budget_mb: float | None = setting(
        None,
        "For all logs of this name, MB: beyond it the oldest is removed. Without it none ever is.",
        example=20_000.0,
        above=0,
    )
    disk_reserve_mb: float = setting(
        20.0,
        "Room that stays free on the disk, MB: recording pauses there, and goes on when there is room.",
        at_least=0,
    )
    metrics: str | None = setting(
        None, "HOST:PORT that serves /metrics for Prometheus, and /healthz.", example="127.0.0.1:9464"
    )

    quiet: bool = setting(False, "No live view; notices are still shown.", example=True)
    log_format: Literal["text", "json"] = setting(
        "text", 'Of what is told meanwhile on stderr: "text", or "json", an object a line, for services.'
    )

    @property
    def key_path(self) -> Path | None:
        return None if self.key_file is None else Path(self.key_file)

    def rules(self) -> RotationRules:
        """When the next log begins, and what the logs leave on the disk."""

        def size(mb: float | None) -> int | None:
            return None if mb is None else int(mb * BYTES_PER_MB)

        return RotationRules(
            self.rotate_after,
            size(self.rotate_at_mb),
            size(self.disk_budget_mb),
            int(self.disk_reserve_mb * BYTES_PER_MB),
        )


def check_record_config(config: RecordConfig, where: Callable[[str], str]) -> None:
    """Raises ConfigError where numbers are out of bounds or contradict each other; where: names one."""
    check_bounds(config, where)
    if config.disk_budget_mb is not None and config.rotate_after is None and config.rotate_at_mb is None:
        raise ConfigError(
            f"{where('disk_budget_mb')} {config.disk_budget_mb:g}: only closed logs are removed, so give "
            f"{where('rotate_at_mb')} or {where('rotate_after')} as well"
        )
    if config.disk_budget_mb is not None and config.disk_budget_mb < 2 * (config.rotate_at_mb or 0.0):
        raise ConfigError(
            f"{where('disk_budget_mb')} {config.disk_budget_mb:g}: must hold two logs of "
            f"{where('rotate_at_mb')} {config.rotate_at_mb:g}"
        )


def load_record_config(path: Path) -> RecordConfig:
    """Reads hubodo.toml.

    Paths in it (output, vehicle, calibration, key_file) are relative to the file. Raises ConfigError at the
    first key that is unknown, of the wrong type or out of bounds.
    """
    table = load_toml(path)
    check_known_keys(table, TABLES, str(path))
    config = read_table(table.get("record", {}), RecordConfig, f"{path}: [record]")
    if config.key_file is not None:
        config = replace(config, key_file=str(path.parent / config.key_file))
    check_record_config(config, lambda key: f"{path}: [record] {key} =")
    return config
