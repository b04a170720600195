"""`hubodo record`: from ports to a log, with live odometry."""

from __future__ import annotations

import argparse
import platform
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hubodo.errors import InputError
from hubodo.ingest.live.record_config import RecordConfig, check_record_config, load_record_config
from hubodo.listening.descriptors import raise_descriptor_limit
from hubodo.vehicle import load_vehicle
from hubodo.verbs.effect_options import add_effects_option, know_effects
from hubodo.verbs.numbers import baud, positive
from hubodo.verbs.udp_options import add_udp_arguments, udp_settings
from hubodo.verbs.watch_gap import watching_gap
from hubodo.verbs.web_options import add_web_arguments, watched
from hubodo.version import __version__
from hubowire import FINGERPRINT
from hubowire.budget import CONSOLE_BAUD, UART_BAUD

if TYPE_CHECKING:
    from hubodo.ingest.live.status import RecordResult

EXAMPLE = "hubodo record left=/dev/ttyACM0 right=/dev/ttyACM1 --vehicle wheelchair.toml -o ride.mcap"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Ports and everything that hubodo.toml can also say."""
    parser.add_argument(
        "ports",
        nargs="*",
        metavar="PORT",
        help="[NAME=]/dev/..., USB serial number, socket://HOST:PORT (connect) or udp://HOST:PORT (listen)",
    )
    parser.add_argument(
        "-o", "--output", type=Path, metavar="FILE.mcap", help="the log, which must not exist, or a folder"
    )
    parser.add_argument(
        "--config", type=Path, metavar="TOML", help="hubodo.toml, for whatever is not given here"
    )
    parser.add_argument("--vehicle", type=Path, metavar="TOML", help="geometry: switches live odometry on")
    parser.add_argument(
        "--calibration", type=Path, metavar="TOML", help="applied to what the odometry gets; raw is recorded"
    )
    add_effects_option(parser)
    parser.add_argument(
        "--gnss",
        metavar="PORT",
        help="a GNSS receiver that speaks NMEA; with --vehicle also where on the map (map → odom)",
    )
    parser.add_argument(
        "--baud",
        type=baud,
        help=f"of the nodes' serial ports (default {UART_BAUD}; {CONSOLE_BAUD} for an ESP32 on its USB "
        f"converter; USB of a Pico does not care)",
    )
    parser.add_argument("--gnss-baud", type=baud, help="of the receiver's serial port (default 9600)")
    parser.add_argument("--duration", type=positive, metavar="S", help="stop after so many seconds")
    parser.add_argument(
        "--time-scale",
        type=positive,
        metavar="N",
        help="for emulated nodes: a second of the log takes N seconds",
    )
    add_web_arguments(parser)
    add_udp_arguments(parser)
    _add_log_arguments(parser)


def _add_log_arguments(parser: argparse.ArgumentParser) -> None:
    """How the logs follow each other, and what is told meanwhile."""
    parser.add_argument(
        "--rotate-after", type=positive, metavar="S", help="begin another log after so many seconds"
    )
    parser.add_argument("--rotate-at-mb", type=positive, metavar="MB", help="begin another log at this size")
    parser.add_argument(
        "--disk-budget-mb",
        type=positive,
        metavar="MB",
        help="of all logs of this name; the oldest go first (default: none is ever removed)",
    )
    parser.add_argument("--metrics", metavar="HOST:PORT", help="serve /metrics for Prometheus, and /healthz")
    parser.add_argument(
        "--wait",
        action="store_true",
        help="wait for ports that are not there yet, or busy, and for room on the disk",
    )
    parser.add_argument(
        "--watch-gap",
        action="store_true",
        help="with --vehicle: read the growing log, and say once what is wrong with a node or a wheel",
    )
    parser.add_argument("--quiet", action="store_true", help="no live view; warnings are still shown")
    parser.add_argument(
        "--log-format",
        choices=("text", "json"),
        help="of what is told meanwhile on stderr; json: an object a line, for services (default: text)",
    )


def run(args: argparse.Namespace) -> RecordResult:
    """Records; see `hubodo.ingest.live.daemon.record`."""
    # Not with the options: a shell that completes them need not wait for all of the odometry.
    from hubodo.calibration.file import read_calibration
    from hubodo.ingest.live.daemon import record
    from hubodo.ingest.live.program_log import program_log

    raise_descriptor_limit()
    know_effects(args)
    config, folder = RecordConfig(), Path()
    attachments: dict[str, bytes] = {}
    if args.config is not None:
        config, folder = load_record_config(args.config), args.config.parent
        attachments["hubodo.toml"] = args.config.read_bytes()
    output = args.output or (folder / config.output if config.output is not None else None)
    vehicle_path = args.vehicle or (folder / config.vehicle if config.vehicle is not None else None)
    config = replace(config, **_options(args))
    # An error is shown in the same form, wherever that was chosen.
    args.log_format = config.log_format
    if output is None:
        raise InputError("no output file; give one with -o FILE.mcap")
    if not config.ports and config.gnss is None:
        raise InputError("no port; name at least one, such as /dev/ttyACM0")
    check_record_config(config, lambda key: f"--{key.replace('_', '-')}")
    vehicle = None
    if vehicle_path is not None:
        vehicle = load_vehicle(vehicle_path)
        attachments["vehicle.toml"] = vehicle_path.read_bytes()
    calibration_path = args.calibration or (folder / config.calibration if config.calibration else None)
    calibration = None
    if calibration_path is not None:
        calibration = read_calibration(calibration_path)
        attachments["calibration.toml"] = calibration_path.read_bytes()
    with (
        program_log("record", config.log_format),
        watched(args, output, vehicle) as audience,
        watching_gap(args.watch_gap, output, vehicle_path) as watch,
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
    """Return the settings that are given on the command line."""
    given: dict[str, Any] = {
        "ports": tuple(args.ports) or None,
        "gnss": args.gnss,
        "baud": args.baud,
        "gnss_baud": args.gnss_baud,
        "duration": args.duration,
        "wait": args.wait or None,
        **udp_settings(args),
        "time_scale": args.time_scale,
        "rotate_after": args.rotate_after,
        "rotate_at_mb": args.rotate_at_mb,
        "disk_budget_mb": args.disk_budget_mb,
        "metrics": args.metrics,
        "quiet": args.quiet or None,
        "log_format": args.log_format,
    }
    return {key: value for key, value in given.items() if value is not None}


def _metadata(config: RecordConfig) -> dict[str, str]:
    """What made the log."""
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
