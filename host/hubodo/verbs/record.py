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
from hubodo.verbs.key_options import add_key_arguments, key_settings
from hubodo.verbs.ros2_options import add_ros2_arguments, ros2_config
from hubodo.verbs.setting_options import add_setting_option, setting_help
from hubodo.verbs.watch_gap import run_gap_watch
from hubodo.verbs.web_options import add_web_arguments, live_views
from hubodo.version import __version__
from hubowire import FINGERPRINT

if TYPE_CHECKING:
    from hubodo.ingest.live.record_result import RecordResult

EXAMPLE = "hubodo record left=/dev/ttyACM0 right=/dev/ttyACM1 --vehicle wheelchair.toml -o ride.mcap"


_FIRST_OPTIONS = ("gnss", "baud", "gnss_baud", "duration", "time_scale")
_LOG_OPTIONS = (
    *("rotate_after", "rotate_at_mb", "disk_budget_mb", "metrics", "mavlink"),
    *("wait", "quiet", "log_format"),
)
"""Settings that are options as well, in the order of `--help`; the others are in hubodo.toml alone."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo record`, most of which can be set in hubodo.toml too."""
    parser.add_argument("ports", nargs="*", metavar="PORT", help=setting_help(RecordConfig, "ports"))
    add_setting_option(parser, RecordConfig, "output", "-o", parse=Path)
    parser.add_argument(
        "--config", type=Path, metavar="TOML", help="hubodo.toml; options on the command line override it"
    )
    for name in ("vehicle", "calibration"):
        add_setting_option(parser, RecordConfig, name, parse=Path)
    add_effects_option(parser)
    for name in _FIRST_OPTIONS:
        add_setting_option(parser, RecordConfig, name)
    add_web_arguments(parser)
    add_ros2_arguments(parser)
    add_key_arguments(parser)
    for name in _LOG_OPTIONS:
        add_setting_option(parser, RecordConfig, name)
    parser.add_argument(
        "--watch-gap",
        action="store_true",
        help="with --vehicle: analyse the growing log and report mounting and wheel errors once",
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
    ros2 = ros2_config(args, has_topics=bool(config.topic_ports()))
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
            ros2=ros2,
        )


def _options(args: argparse.Namespace) -> dict[str, Any]:
    """Return the settings given on the command line; an option has the name of its setting."""
    names = {item.name for item in fields(RecordConfig)} - {"output", "vehicle", "calibration"}
    given = {name: getattr(args, name, None) for name in names}
    given |= {"ports": tuple(args.ports) or None, **key_settings(args)}
    return {name: value for name, value in given.items() if value is not None and value is not False}


def _metadata(config: RecordConfig) -> dict[str, str]:
    """Return the metadata of the log: versions and system."""
    metadata = {
        "hubodo": __version__,
        "fingerprint": f"{FINGERPRINT:08x}",
        "python": platform.python_version(),
        "system": platform.platform(),
        "verb": "record",
    }
    if config.odometry_rate_hz is not None:
        metadata["odometry_rate_hz"] = repr(config.odometry_rate_hz)
    return metadata
