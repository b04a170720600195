"""The options by which every verb that reads a log is told what a foreign file does not say itself."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path

from hubodo.errors import InputError
from hubodo.log.number_recording import InputFormat
from hubodo.log.roles import ALL_ROLES, NODES_ROLE, ROLE_TYPES, TopicSelection
from hubodo.recording import Recording
from hubodo.vehicle import Vehicle
from hubodo.verbs.numbers import positive

LOG_HELP = "MCAP, rosbag or rosbag2, CSV folder, or one file of numbers (CSV, MATLAB, HDF5, numpy)"


def add_log_options(parser: argparse.ArgumentParser) -> None:
    """--topic, --max-memory, --rate, --unit, --columns, --variable."""
    add_topic_option(parser)
    group = parser.add_argument_group("files that do not say it themselves")
    group.add_argument(
        "--rate", type=positive, metavar="HZ", help="samples per second, where there are no times"
    )
    group.add_argument(
        "--unit",
        action="append",
        default=[],
        metavar="UNIT",
        help="rad/s, deg/s, mdeg/s, deg/h, m/s^2, g, mg; of a count: '0.00875 deg/s'; once for each sensor",
    )
    group.add_argument(
        "--columns",
        metavar="NAMES",
        help="what each column is, as in t,gx,gy,gz,-,temperature",
    )
    group.add_argument("--variable", metavar="NAMES", help="arrays of a MATLAB, HDF5 or numpy file")


def add_topic_option(parser: argparse.ArgumentParser) -> None:
    """--topic and --max-memory."""
    parser.add_argument(
        "--topic",
        action="append",
        default=[],
        metavar="NAME=/TOPIC",
        help=f"which topic of another program's log is a node, as in left=/imu/left_wheel, or one of "
        f"{', '.join(ROLE_TYPES)}; wheels=/joint_states:LEFT,RIGHT names joints, NAME=- leaves one out; "
        "repeatable (default: [topics] of the vehicle file, else by message type)",
    )
    add_memory_option(parser)


def add_memory_option(parser: argparse.ArgumentParser) -> None:
    """Add --max-memory, which `cli` and `batch` apply while a verb runs."""
    parser.add_argument(
        "--max-memory",
        type=_megabytes,
        metavar="MB",
        help="memory that reading a file may take; a file that claims more is refused (default: a quarter of "
        "this computer's)",
    )


def _megabytes(text: str) -> int:
    """Return bytes from a number of megabytes."""
    return int(positive(text) * 1e6)


def add_vehicle_option(parser: argparse.ArgumentParser) -> None:
    """--vehicle, for verbs that want nothing else of a vehicle."""
    parser.add_argument(
        "--vehicle",
        type=Path,
        metavar="TOML",
        help="its [topics], nodes and wheel_radius, for a log of another program",
    )


def log_form(
    args: argparse.Namespace, vehicle: Vehicle | None = None, *, needed: Iterable[str] = ALL_ROLES
) -> InputFormat:
    """What the options and `[topics]` say. needed: roles without which the verb cannot do its work.

    Raises InputError for two units of one sensor and for a --topic that is none.
    """
    columns = () if args.columns is None else tuple(name.strip() for name in args.columns.split(","))
    channel = getattr(args, "channel", None) or "gz"
    form = InputFormat(
        args.rate, tuple(args.unit), columns, args.variable, channel, topic_choice(args, vehicle, needed)
    )
    if len(form.si_factors()) < len(form.units):
        raise InputError(
            f"--unit {', '.join(form.units)}: at most one for the gyro and one for the accelerometer"
        )
    return form


def topic_choice(args: argparse.Namespace, vehicle: Vehicle | None, needed: Iterable[str]) -> TopicSelection:
    """What --topic and `[topics]` say, as `log_form` has it."""
    said: dict[str, str] = {}
    for text in args.topic:
        name, _, topic = (part.strip() for part in text.partition("="))
        if not name or not topic or name == NODES_ROLE:
            raise InputError(f"--topic {text}: write NAME=/TOPIC, as in left=/imu/left_wheel or gnss=/fix")
        if said.setdefault(name, topic) != topic:
            raise InputError(f"--topic {name}: is {said[name]} and {topic}; say one")
    if vehicle is None:
        return TopicSelection(said, required_roles=frozenset(needed))
    on_wheels = {name: mount.side is not None for name, mount in vehicle.nodes.items()}
    return TopicSelection(said, vehicle.topics, on_wheels, vehicle.wheel_radius, frozenset(needed))


def check_nodes(recording: Recording, log: Path) -> None:
    """Raises InputError for a log without a node, which is another thing than one of another name."""
    if not recording.nodes:
        raise InputError(f"{log}: holds no samples of an IMU; hubodo info shows what it has")
