"""`[record]` of hubodo.toml: defaults of a recording."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from hubodo.errors import ConfigError
from hubodo.toml_file import load_toml, only_keys, read_table
from hubowire.budget import UART_BAUD


@dataclass(frozen=True, slots=True)
class RecordConfig:
    """``[record]`` of hubodo.toml: defaults for `hubodo record`; the command line goes before them.

    ports: as on the command line. duration: s, None until stopped. odometry_rate_hz: poses a second at most,
    None: one for every sample.
    clock_request_period: s between two questions for a node's clock.
    metrics: HOST:PORT that serves /metrics and /healthz.
    time_scale: for emulated nodes that are slower than real time: a second of the log takes so many seconds.
    """

    ports: tuple[str, ...] = ()
    output: str | None = None
    vehicle: str | None = None
    calibration: str | None = None
    gnss: str | None = None
    gnss_baud: int = 9600
    baud: int = UART_BAUD
    wait: bool = False
    duration: float | None = None
    compression: Literal["zstd", "lz4", "none"] = "zstd"
    odometry_rate_hz: float | None = None
    clock_request_period: float = 1.0
    time_scale: float = 1.0
    metrics: str | None = None


def load_record_config(path: Path) -> RecordConfig:
    """Reads hubodo.toml.

    Paths in it (output, vehicle, calibration) are relative to the file. Raises ConfigError at the first key
    that is unknown or of the wrong type.
    """
    table = load_toml(path)
    only_keys(table, ("record",), str(path))
    config = read_table(table.get("record", {}), RecordConfig, f"{path}: [record]")
    for key in ("gnss_baud", "baud", "odometry_rate_hz", "clock_request_period", "time_scale"):
        if getattr(config, key) is not None and not getattr(config, key) > 0:
            raise ConfigError(f"{path}: [record] {key} = {getattr(config, key)}: must be above 0")
    if config.duration is not None and not config.duration > 0:
        raise ConfigError(f"{path}: [record] duration = {config.duration}: must be above 0")
    return config
