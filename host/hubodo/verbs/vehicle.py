"""`hubodo vehicle`: write a vehicle file by answering questions, and check it by a push over a tape."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from hubodo.atomic_files import write_atomically
from hubodo.errors import ConfigError, InputError
from hubodo.fuse.mounting_speed import MountingSpeed, mounting_speeds
from hubodo.fuse.push_check import STANDSTILL_DURATION, WheelPush, check_push
from hubodo.lengths import format_length, parse_length
from hubodo.log.any_log import read_log
from hubodo.log.roles import NODES_ROLE
from hubodo.pages.console import print_lines, print_table
from hubodo.vehicle import (
    RADIUS_SOURCES,
    Facing,
    NodeMount,
    Side,
    Vehicle,
    check_plausible_size,
    load_vehicle,
)
from hubodo.vehicle_sketch import draw_vehicle, vehicle_toml
from hubodo.verbs.log_options import LOG_HELP, add_log_options, stated_input_format
from hubodo.verbs.numbers import latitude
from hubodo.verbs.outputs import add_force_option

EXAMPLE = """hubodo vehicle new -o vehicle.toml                             # asks for each size
  hubodo vehicle new --diameter '33 cm' --track '55 cm' -o vehicle.toml
  hubodo vehicle check vehicle.toml push.mcap --push 2m          # pushed straight over a tape"""

_SizeCheck = Callable[[str, float, str], None]
_FACINGS = ("left", "right", "outwards", "inwards")


@dataclass(frozen=True)
class VehicleResult:
    """A vehicle file, and what a push says about it.

    Attributes
    ----------
    path
        The file.
    vehicle
        Its content.
    pushes
        The radius that each wheel implies, empty without a push.
    speeds
        Speeds at which the sensors of each wheel node reach their ranges.
    """

    path: str
    vehicle: Vehicle
    pushes: tuple[WheelPush, ...] = ()
    speeds: tuple[MountingSpeed, ...] = ()

    @property
    def failed(self) -> bool:
        """Return True if the push contradicts the file."""
        return any(push.problem for push in self.pushes)

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result; lengths in m, angles in rad."""
        return {
            "file": self.path,
            "wheel_radius": self.vehicle.wheel_radius,
            "track_width": self.vehicle.track_width,
            "nodes": {name: {"side": m.side, "facing": m.facing} for name, m in self.vehicle.nodes.items()},
            "push": [
                {
                    "node": p.node,
                    "angle": p.angle,
                    "radius": p.radius,
                    "sigma": p.sigma,
                    "problem": p.problem,
                }
                for p in self.pushes
            ],
            "speeds": [speed.as_json() for speed in self.speeds],
        }

    def render(self, console: Console) -> None:
        """Print the sketch, and a row for each wheel that was pushed."""
        print_lines(console, draw_vehicle(self.vehicle))
        if self.pushes:
            rows = [
                (
                    push.node,
                    f"{push.angle:.2f} rad",
                    f"{100 * push.radius:.1f} ± {100 * push.sigma:.1f} cm",
                    format_length(self.vehicle.wheel_radius),
                    push.problem or "agrees",
                )
                for push in self.pushes
            ]
            print_table(
                console, ("node", "wheel turned", "radius by the push", "in the file", "verdict"), rows
            )
        print_lines(console, [speed.description for speed in self.speeds])
        print_lines(console, [self.path])


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo vehicle new` and `hubodo vehicle check`."""
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="KIND")
    words = "write a vehicle file; what is not given is asked for on a terminal"
    new = kinds.add_parser("new", help=words, description=words)
    size = new.add_mutually_exclusive_group()
    size.add_argument(
        "--diameter", metavar="LENGTH", help="of the wheel under load, such as '33 cm' or '13 in'"
    )
    size.add_argument("--radius", metavar="LENGTH", help="of the wheel, from the axle to the ground")
    new.add_argument(
        "--radius-from",
        choices=RADIUS_SOURCES,
        default="nominal",
        help="how the size of the wheel was determined; sets its sigma (default: nominal)",
    )
    new.add_argument("--track", metavar="LENGTH", help="between the contact points of the two wheels")
    for side in ("left", "right"):
        new.add_argument(
            f"--{side}-facing",
            choices=(*_FACINGS, "none"),
            help=f"where the z axis of the {side} node points; none: no node on this wheel",
        )
    new.add_argument(
        "--antenna",
        nargs=2,
        metavar=("FORWARD", "LEFT"),
        help="GNSS antenna from the middle of the axle, such as '50 cm' '0 cm'",
    )
    new.add_argument("--latitude-deg", type=latitude, help="for the correction of Earth rate")
    new.add_argument(
        "--unusual-size", action="store_true", help="accept a wheel beyond 2 m or a track below 5 cm"
    )
    new.add_argument("-o", "--output", type=Path, default=Path("vehicle.toml"), metavar="TOML")
    new.add_argument("--log", type=Path, metavar="LOG", help="log of a push, for --push")
    check = kinds.add_parser("check", help="check a vehicle file by the log of a push straight ahead")
    check.add_argument("vehicle", type=Path, metavar="TOML", help="[vehicle] and [nodes.*]")
    check.add_argument("log", type=Path, metavar="LOG", help=LOG_HELP)
    for kind in (new, check):
        kind.add_argument(
            "--push",
            metavar="LENGTH",
            required=kind is check,
            help=f"distance pushed, such as 2m; stand still {STANDSTILL_DURATION:g} s before and after",
        )
        # Common options are accepted after KIND too; SUPPRESS keeps a value that was given before KIND.
        for option in ("--json", "--debug"):
            kind.add_argument(option, action="store_true", default=argparse.SUPPRESS, help=argparse.SUPPRESS)
    add_force_option(new, "output")
    add_log_options(check)
    new.set_defaults(topic=[], rate=None, unit=[], columns=None, zero=[], scale=[], variable=None)


def run(args: argparse.Namespace) -> VehicleResult:
    """Write the vehicle file, or check one.

    Returns
    -------
    VehicleResult
        The vehicle, and what the push says about it.

    Raises
    ------
    InputError
        If a size is missing or has no unit, or the log shows no push.
    ConfigError
        If a size is not plausible.
    """
    if args.kind == "check":
        vehicle = load_vehicle(args.vehicle)
        return _check(args, vehicle, args.vehicle)
    if (args.push is None) != (args.log is None):
        raise InputError("--push and --log go together: the distance, and the log of the push")
    vehicle = _ask_vehicle(args, _prompt if sys.stdin.isatty() else None)
    result = VehicleResult(str(args.output), vehicle, speeds=tuple(mounting_speeds(vehicle, {})))
    if args.push is not None:
        result = _check(args, vehicle, args.output)
    write_atomically(args.output, vehicle_toml(vehicle))
    return result


def _check(args: argparse.Namespace, vehicle: Vehicle, path: Path) -> VehicleResult:
    """Return the vehicle of a file, compared with the log of a push."""
    distance = parse_length(args.push, "--push")
    recording = read_log(args.log, input_format=stated_input_format(args, vehicle, needed=(NODES_ROLE,)))
    pushes = check_push(recording, vehicle, distance, str(args.log))
    return VehicleResult(str(path), vehicle, pushes, tuple(mounting_speeds(vehicle, recording.metadata)))


def _prompt(question: str) -> str:
    """Ask on the terminal; the question goes to stderr, so that stdout holds the result alone."""
    print(f"{question} ", end="", file=sys.stderr, flush=True)
    answer = sys.stdin.readline()
    if not answer:
        raise InputError("the answers ended; nothing was written")
    return answer.strip()


def _ask_vehicle(args: argparse.Namespace, ask: Callable[[str], str] | None) -> Vehicle:
    """Return the vehicle of the options.

    ask: asks the user for a missing option and returns the answer; None if nobody can answer.
    """
    check = _accept_any_size if args.unusual_size else check_plausible_size
    if args.radius is not None:
        radius = _size(check, "wheel_radius", args.radius, "--radius")
    elif args.diameter is not None:
        radius = _size(check, "wheel_radius", args.diameter, "--diameter", 0.5)
    else:
        radius = _ask_size(
            check,
            ask,
            "wheel_radius",
            "diameter of the loaded wheel, such as 33 cm?",
            "--diameter",
            0.5,
        )
    if args.track is not None:
        track = _size(check, "track_width", args.track, "--track")
    else:
        track = _ask_size(check, ask, "track_width", "track, between the contact points?", "--track", 1.0)
    nodes: dict[str, NodeMount] = {}
    sides: tuple[Side, Side] = ("left", "right")
    for side in sides:
        answer = getattr(args, f"{side}_facing")
        while answer is None and ask is not None:
            text = ask(f"z axis of the {side} node: left, right, outwards, inwards, none [left]:")
            answer = next(
                (word for word in (*_FACINGS, "none") if word.startswith(text.lower() or "left")), None
            )
        facing = _facing(side, answer or "left")
        if facing is not None:
            nodes[side] = NodeMount(side, facing)
    if not nodes:
        raise InputError(
            "--left-facing none --right-facing none: a vehicle needs a node on one wheel at least"
        )
    antenna = None
    if args.antenna is not None:
        antenna = _offset(args.antenna[0]), _offset(args.antenna[1])
    return Vehicle(radius, track, nodes, antenna, args.latitude_deg, radius_from=args.radius_from)


def _accept_any_size(name: str, value: float, where: str) -> None:
    """Accept every size."""


def _size(check: _SizeCheck, name: str, text: str, option: str, factor: float = 1.0) -> float:
    """Return a size in metres that a vehicle can have; factor: 0.5 for a diameter."""
    value = float(f"{factor * parse_length(text, option):.9g}")
    check(name, value, f"{option} {text.strip()}: {name}")
    return value


def _ask_size(
    check: _SizeCheck, ask: Callable[[str], str] | None, name: str, question: str, option: str, factor: float
) -> float:
    """Ask until the answer is a plausible length."""
    if ask is None:
        raise InputError(f"{option} is missing; give it, such as {option} '33 cm' (a terminal is asked)")
    while True:
        text = ask(question)
        share = 1.0 if "radius" in text else factor
        try:
            return _size(check, name, text.replace("radius", "").replace("diameter", ""), "answer", share)
        except (InputError, ConfigError) as error:
            print(error, file=sys.stderr)


def _offset(text: str) -> float:
    """Return a length that may be 0 or negative."""
    bare = text.strip().lstrip("+-")
    if bare.split(" ")[0].rstrip("cm") in ("0", "0.0"):
        return 0.0
    return (-1.0 if text.strip().startswith("-") else 1.0) * parse_length(bare, "--antenna")


def _facing(side: Side, answer: str) -> Facing | None:
    """Return the side to which a z axis points; None without a node."""
    other: Facing = "right" if side == "left" else "left"
    return {"left": "left", "right": "right", "outwards": side, "inwards": other, "none": None}[answer]
