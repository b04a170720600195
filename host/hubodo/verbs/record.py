"""`hubodo record`: record nodes into a log, with live odometry."""

from __future__ import annotations

import argparse
import platform
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hubodo.errors import InputError
from hubodo.ingest.live.record_config import RecordConfig, check_record_config, load_record_config
from hubodo.listening.descriptors import raise_descriptor_limit
from hubodo.vehicle import load_vehicle
from hubodo.verbs.effect_options import add_effects_option, register_effects
from hubodo.verbs.numbers import baud_rate, positive_number
from hubodo.verbs.udp_options import add_udp_arguments, udp_settings
from hubodo.verbs.watch_gap import run_gap_watch
from hubodo.verbs.web_options import add_web_arguments, live_views
from hubodo.version import __version__
from hubowire import FINGERPRINT
from hubowire.budget import CONSOLE_BAUD, UART_BAUD

if TYPE_CHECKING:
    from hubodo.ingest.live.status import RecordResult

EXAMPLE = "hubodo record left=/dev/ttyACM0 right=/dev/ttyACM1 --vehicle wheelchair.toml -o ride.mcap"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo record`, most of which can be set in hubodo.toml too."""
    parser.add_argument(
        "ports",
        nargs="*",
        metavar="PORT",
        help="[NAME=]/dev/..., USB serial number, socket://HOST:PORT (connect) or udp://HOST:PORT (listen)",
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="FILE.mcap",
        help="log to write, which must not exist, or a folder",
    )
    parser.add_argument(
        "--config", type=Path, metavar="TOML", help="hubodo.toml; options on the command line override it"
    )
    parser.add_argument("--vehicle", type=Path, metavar="TOML", help="vehicle file; enables live odometry")
    parser.add_argument(
        "--calibration",
        type=Path,
        metavar="TOML",
        help="calibration for the live odometry; the log holds raw samples",
    )
    add_effects_option(parser)
    parser.add_argument(
        "--gnss",
        metavar="PORT",
        help="GNSS receiver (NMEA); with --vehicle it places the odometry on the map (map → odom)",
    )
    parser.add_argument(
        "--baud",
        type=baud_rate,
        help=f"baud rate of the nodes (default {UART_BAUD}; {CONSOLE_BAUD} for an ESP32 behind a USB "
        f"converter; irrelevant for the USB port of a Pico)",
    )
    parser.add_argument("--gnss-baud", type=baud_rate, help="baud rate of the GNSS receiver (default 9600)")
    parser.add_argument("--duration", type=positive_number, metavar="S", help="stop after this time, s")
    parser.add_argument(
        "--time-scale",
        type=positive_number,
        metavar="N",
        help="for emulated nodes: each second of the log takes N seconds",
    )
    add_web_arguments(parser)
    add_udp_arguments(parser)
    _add_log_arguments(parser)


def _add_log_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments for log rotation, disk budget and messages."""
    parser.add_argument(
        "--rotate-after", type=positive_number, metavar="S", help="start a new log after this time, s"
    )
    parser.add_argument(
        "--rotate-at-mb", type=positive_number, metavar="MB", help="start a new log at this size"
    )
    parser.add_argument(
        "--disk-budget-mb",
        type=positive_number,
        metavar="MB",
        help="disk budget of all logs of this name; the oldest are deleted first (default: none is deleted)",
    )
    parser.add_argument("--metrics", metavar="HOST:PORT", help="serve /metrics for Prometheus, and /healthz")
    parser.add_argument(
        "--wait",
        action="store_true",
        help="wait for missing or busy ports and for free disk space",
    )
    parser.add_argument(
        "--watch-gap",
        action="store_true",
        help="with --vehicle: analyse the growing log and report mounting and wheel errors once",
    )
    parser.add_argument("--quiet", action="store_true", help="no live view; warnings are still printed")
    parser.add_argument(
        "--log-format",
        choices=("text", "json"),
        help="format of the messages on stderr; json: one object per line, for services (default: text)",
    )


def run(args: argparse.Namespace) -> RecordResult:
    """Record until ctrl-C or --duration; see `hubodo.ingest.live.daemon.record`.

    Returns
    -------
    RecordResult
        Rates, losses and clock of each node, with the logs that were written.

    Raises
    ------
    InputError, ConfigError
        If no port or output is given, or an option or hubodo.toml is invalid.
    LinkError
        If a port cannot be opened.
    """
    # Imported here: shell completion need not load the odometry.
    from hubodo.calibration.file import read_calibration
    from hubodo.ingest.live.daemon import record
    from hubodo.ingest.live.program_log import program_log

    raise_descriptor_limit()
    register_effects(args)
    config, folder = RecordConfig(), Path()
    attachments: dict[str, bytes] = {}
    if args.config is not None:
        config, folder = load_record_config(args.config), args.config.parent
        attachments["hubodo.toml"] = args.config.read_bytes()
    output = args.output or (folder / config.output if config.output is not None else None)
    vehicle_path = args.vehicle or (folder / config.vehicle if config.vehicle is not None else None)
    config = replace(config, **_options(args))
    # Errors use the same format, whether it was set on the command line or in hubodo.toml.
    args.log_format = config.log_format
    if output is None:
        raise InputError("no output file; give one with -o FILE.mcap")
    if not config.ports and config.gnss is None:
        raise InputError("no port; give at least one, such as /dev/ttyACM0")
    check_record_config(config, lambda key: f"--{key.replace('_', '-')}")
    vehicle = None if vehicle_path is None else load_vehicle(vehicle_path)
    if vehicle_path is not None:
        attachments["vehicle.toml"] = vehicle_path.read_bytes()
    calibration_path = args.calibration or (folder / config.calibration if config.calibration else None)
    calibration = None
    if calibration_path is not None:
        calibration = read_calibration(calibration_path)
        attachments["calibration.toml"] = calibration_path.read_bytes()
    with (
        program_log("record", config.log_format),
        live_views(args, output, vehicle) as audience,
        run_gap_watch(args.watch_gap, output, vehicle_path) as watch,
    ):
        return record(
            config,
            output,
            vehicle=vehicle,
            calibration=calibration,
            metadata=_metadata(config),
            attachments=attachments,
            watch=watch,
            audience=audience,
        )


def _options(args: argparse.Namespace) -> dict[str, Any]:
    """Return the settings given on the command line; an option has the name of its setting."""
    names = {item.name for item in fields(RecordConfig)} - {"output", "vehicle", "calibration"}
    given = {name: getattr(args, name, None) for name in names}
    given |= {"ports": tuple(args.ports) or None, **udp_settings(args)}
    return {name: value for name, value in given.items() if value is not None and value is not False}


def _metadata(config: RecordConfig) -> dict[str, str]:
    """Return the metadata of the log: versions, system and ports."""
    metadata = {
        "hubodo": __version__,
        "fingerprint": f"{FINGERPRINT:08x}",
        "python": platform.python_version(),
        "system": platform.platform(),
        "ports": " ".join(config.ports),
        "verb": "record",
    }
    if config.odometry_rate_hz is not None:
        metadata["odometry_rate_hz"] = repr(config.odometry_rate_hz)
    return metadata
