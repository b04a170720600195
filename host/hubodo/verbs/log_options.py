"""Options of all verbs that read a log: topics, and metadata that a foreign file lacks."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from hubodo.errors import InputError
from hubodo.log.number_recording import IMU_CHANNELS, InputFormat
from hubodo.log.roles import ALL_ROLES, NODES_ROLE, ROLE_TYPES, TopicSelection
from hubodo.log.units import sensor_of_unit
from hubodo.recording import Recording
from hubodo.spelling import suggest_spelling
from hubodo.vehicle import Vehicle, load_vehicle
from hubodo.verbs.numbers import positive_number

_BODY_NODES = ("frame",)
"""Names of nodes beside those of a vehicle file; a model may use the yaw rate of one on the body."""
VEHICLE_FILE = "vehicle.toml"
LOG_HELP = "MCAP, rosbag or rosbag2, CSV folder, or one numeric file (CSV, MATLAB, HDF5, NumPy)"

VEHICLE_HELP = (
    "vehicle file: [vehicle] with wheel_radius, radius_from (tape, rolled or nominal: its sigma) and "
    "track_width, and [nodes.*]"
)


def add_log_options(parser: argparse.ArgumentParser) -> None:
    """Add --topic, --max-memory, --rate, --unit, --columns and --variable."""
    add_topic_option(parser)
    group = parser.add_argument_group("files without metadata")
    group.add_argument(
        "--rate", type=positive_number, metavar="HZ", help="sample rate of a file without timestamps"
    )
    group.add_argument(
        "--unit",
        action="append",
        default=[],
        metavar="UNIT",
        help="rad/s, deg/s, mdeg/s, deg/h, m/s^2, g, mg, or per count: '0.00875 deg/s'; once per sensor",
    )
    group.add_argument(
        "--columns",
        metavar="NAMES",
        help="meaning of each column, such as t,gx,gy,gz,-,temperature; - ignores one (default: by a header "
        "such as timestamp_us, gx, acc_z or `Gyroscope x (rad/s)`)",
    )
    group.add_argument(
        "--zero",
        action="append",
        default=[],
        metavar="[CHANNEL=]COUNTS",
        help="counts of an A/D converter at zero, of all channels or of one, such as gx=2045; repeatable",
    )
    group.add_argument(
        "--scale",
        action="append",
        default=[],
        metavar="[CHANNEL=]FACTOR",
        help="value of one count in the unit of --unit, of all channels or of one, such as gx=0.13; "
        "repeatable",
    )
    group.add_argument("--variable", metavar="NAMES", help="arrays of a MATLAB, HDF5 or NumPy file")


def add_topic_option(parser: argparse.ArgumentParser) -> None:
    """Add --topic and --max-memory."""
    parser.add_argument(
        "--topic",
        action="append",
        default=[],
        metavar="NAME=/TOPIC",
        help=f"topic of a node, such as left=/imu/left_wheel, or of {', '.join(ROLE_TYPES)}, in a log of "
        "another program; wheels=/joint_states:LEFT,RIGHT names joints, NAME=- ignores one; repeatable "
        "(default: [topics] of the vehicle file, else by message type)",
    )
    add_memory_option(parser)


def add_memory_option(parser: argparse.ArgumentParser) -> None:
    """Add --max-memory; `cli` and `batch` enforce it while a verb runs."""
    parser.add_argument(
        "--max-memory",
        type=_megabytes,
        metavar="MB",
        help="memory limit for reading a file; a file that declares more is refused (default: a quarter of "
        "the memory of this computer)",
    )


def _megabytes(text: str) -> int:
    """Convert a number of megabytes to bytes."""
    return int(positive_number(text) * 1e6)


def add_vehicle_option(parser: argparse.ArgumentParser) -> None:
    """Add --vehicle, for verbs that use it only to interpret a foreign log."""
    parser.add_argument(
        "--vehicle",
        type=Path,
        metavar="TOML",
        help="vehicle file whose [topics], nodes and wheel_radius interpret a log of another program",
    )


def stated_input_format(
    args: argparse.Namespace, vehicle: Vehicle | None = None, *, needed: Iterable[str] = ALL_ROLES
) -> InputFormat:
    """Return the format of a log as stated by the options and by `[topics]` of the vehicle.

    needed: roles (node, gnss, ...) that the verb cannot do without. Raises InputError for two units of one
    sensor and for an invalid --topic.
    """
    columns = () if args.columns is None else tuple(name.strip() for name in args.columns.split(","))
    channel = getattr(args, "channel", None) or "gz"
    form = InputFormat(
        args.rate,
        split_units(args.unit),
        columns,
        args.variable,
        channel,
        select_topics(args, vehicle, needed),
        channel_numbers("--zero", args.zero),
        channel_numbers("--scale", args.scale),
    )
    all_six = getattr(args, "kalibr", None) or getattr(args, "imu_filter", None)
    if (hasattr(args, "channel") or hasattr(args, "axis")) and not all_six:
        form = replace(form, used_channels=IMU_CHANNELS[:3] if channel[0] == "g" else IMU_CHANNELS[3:])
    if len(form.si_factors()) < len(form.units):
        raise InputError(
            f"--unit {', '.join(form.units)}: at most one for the gyro and one for the accelerometer"
        )
    return form


def split_units(texts: Iterable[str]) -> tuple[str, ...]:
    """Return the units of --unit; one text may hold several, such as `rad/s,m/s^2`."""
    units: list[str] = []
    for text in texts:
        parts = text.split(",")
        units += parts if all(map(sensor_of_unit, parts)) else [text]
    return tuple(units)


def channel_numbers(option: str, texts: Iterable[str]) -> dict[str, float]:
    """Return the number of each channel from texts such as `gx=2045`, `accel=2048`, or `2048` for all.

    Raises InputError for an unknown channel, another text, or a scale of zero.
    """
    groups = {"gyro": IMU_CHANNELS[:3], "accel": IMU_CHANNELS[3:], "": IMU_CHANNELS}
    numbers: dict[str, float] = {}
    for text in texts:
        name, _, number = text.rpartition("=")
        channels = groups.get(name.strip(), (name.strip(),))
        try:
            value = float(number)
        except ValueError:
            value = math.nan
        if not math.isfinite(value) or (option == "--scale" and value == 0.0):
            raise InputError(f"{option} {text}: write a number, or CHANNEL=NUMBER, such as gx=2045")
        if not set(channels) <= set(IMU_CHANNELS):
            raise InputError(f"{option} {text}: the channel is one of {', '.join(IMU_CHANNELS)}, gyro, accel")
        numbers |= dict.fromkeys(channels, value)
    return numbers


def select_topics(args: argparse.Namespace, vehicle: Vehicle | None, needed: Iterable[str]) -> TopicSelection:
    """Return the topic of each role from --topic and `[topics]`; parameters as in `stated_input_format`."""
    given: dict[str, str] = {}
    for text in args.topic:
        name, _, topic = (part.strip() for part in text.partition("="))
        if not name or not topic or name == NODES_ROLE:
            raise InputError(f"--topic {text}: write NAME=/TOPIC, such as left=/imu/left_wheel or gnss=/fix")
        if given.setdefault(name, topic) != topic:
            raise InputError(f"--topic {name}: is {given[name]} and {topic}; give one")
    if vehicle is None:
        return TopicSelection(given, required_roles=frozenset(needed))
    known = (*vehicle.nodes, *ROLE_TYPES, *_BODY_NODES)
    for name in given if vehicle.nodes else ():
        if name not in known:
            raise InputError(
                f"--topic {name}=: no node of the vehicle has this name{suggest_spelling(name, known)}; "
                f"known are {', '.join(known)}"
            )
    on_wheels = {name: mount.side is not None for name, mount in vehicle.nodes.items()}
    return TopicSelection(given, vehicle.topics, on_wheels, vehicle.wheel_radius, frozenset(needed))


def stored_vehicle(log: Path) -> Vehicle:
    """Return the vehicle that a log carries, or `vehicle.toml` of a folder. Raises InputError without one."""
    from hubodo.ingest.replay.odometry_setup import read_odometry_setup  # loads the calibration
    from hubodo.log.any_log import open_source
    from hubodo.log.logfile import Log

    with open_source(log) as source:
        vehicle = read_odometry_setup(source).vehicle if isinstance(source, Log) else None
    if vehicle is None and (log / VEHICLE_FILE).is_file():
        vehicle = load_vehicle(log / VEHICLE_FILE)
    if vehicle is None:
        raise InputError(f"{log}: carries no vehicle; give --vehicle TOML, which `hubodo vehicle new` writes")
    return vehicle


def check_node_names(vehicle: Vehicle, recording: Recording, where: str) -> None:
    """Raise InputError where a node of the vehicle and one of the log differ by a spelling.

    where: the vehicle file, for the error.
    """
    unmatched = [name for name in recording.nodes if name not in vehicle.nodes]
    for name in vehicle.nodes:
        if name not in recording.nodes and (hint := suggest_spelling(name, unmatched)):
            raise InputError(f"{where}: [nodes.{name}]: the log has no such node{hint}")


def check_nodes(recording: Recording, log: Path) -> None:
    """Raise InputError for a log without any node."""
    if not recording.nodes:
        raise InputError(f"{log}: holds no samples of an IMU; hubodo info shows what it has")
