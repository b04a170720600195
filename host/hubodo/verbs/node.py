"""`hubodo node`: one node asked who it is, told a setting, to find its gyro's bias, or to start anew."""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

from rich.console import Console
from rich.table import Table

from hubodo.errors import InputError
from hubodo.ingest.link.ports import parse_port, trusted
from hubodo.ingest.node.bias_filter import filter_seen, filter_words, seen_row
from hubodo.ingest.node.conversation import Conversation
from hubodo.ingest.node.identity import hello_metadata, known_name
from hubodo.ingest.node.scale import RAD_PER_NANO_DEG
from hubodo.terminal import SafeConsole
from hubodo.verbs.numbers import baud, whole
from hubodo.verbs.udp_options import add_udp_arguments
from hubowire import node_name
from hubowire.budget import UART_BAUD
from hubowire.messages import (
    BiasInit,
    BiasKind,
    Board,
    ConfigKey,
    Fault,
    FilterKind,
    FilterState,
    Health,
    Hello,
    RebootMode,
    ResetCause,
    SetConfig,
    Start,
)

EXAMPLE = (
    "hubodo node /dev/ttyACM0 info\n  hubodo node /dev/ttyACM0 set rate_hz=208 filter_kind=kalman\n"
    "  hubodo node /dev/ttyACM0 bias --kind mean\n  hubodo node /dev/ttyACM0 reboot"
)

_HEALTH_S, _FILTER_S, _HELLO_S = 2.5, 1.5, 15.0
_LEAST_SAMPLES, _MOST_SAMPLES = 2000, 65535
_AT_START = (ConfigKey.RATE_HZ, ConfigKey.GYRO_RANGE_DPS, ConfigKey.ACCEL_RANGE_G, ConfigKey.BATCH)
_NAMED: dict[ConfigKey, type[IntEnum]] = {
    ConfigKey.FILTER_KIND: FilterKind,
    ConfigKey.BIAS_KIND: BiasKind,
}


@dataclass(frozen=True)
class NodeResult:
    """What a node is after what was done. done: settings as they were stored.

    bias_filter: its own estimate, rad/s, None while there is none.
    """

    port: str
    action: str
    node_id: int
    hello: Hello
    health: Health | None = None
    bias_filter: dict[str, float] | None = None
    done: dict[str, int] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        health = None if self.health is None else _fields(self.health)
        return {
            "port": self.port,
            "action": self.action,
            "node_id": self.node_id,
            "node": node_name(self.node_id),
            "hello": hello_metadata(self.hello) | _named(self.hello),
            "health": health,
            "faults": _faults(self.health),
            "bias_filter": None
            if self.bias_filter is None
            else {key: None if math.isnan(value) else value for key, value in self.bias_filter.items()},
            "done": self.done,
        }

    def render(self, console: Console) -> None:
        for name, value in self.done.items():
            console.print(f"{name} = {value}: stored", highlight=False, markup=False)
        title = f"node {self.node_id} ({node_name(self.node_id)}) on {self.port}"
        table = Table(title=title, show_header=False)
        for key, text in (hello_metadata(self.hello) | _named(self.hello)).items():
            table.add_row(key, text)
        if self.health is not None:
            table.add_row("faults", ", ".join(_faults(self.health)) or "none")
            for key, value in _fields(self.health).items():
                if key not in ("faults", "reset_cause", "stamp_bound_us"):
                    table.add_row(key, str(value))
        if self.bias_filter is not None:
            table.add_row("bias", filter_words(self.bias_filter))
        console.print(table, highlight=False)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The port, what to do there, and with what."""
    parser.add_argument(
        "port",
        metavar="PORT",
        help="/dev/..., USB serial number, socket://HOST:PORT (connect) or udp://HOST:PORT (listen)",
    )
    parser.add_argument(
        "action",
        choices=("info", "set", "bias", "reboot"),
        help="info: what it is and how it fares; set: store settings; bias: the gyro's bias, as --kind says; "
        "reboot: start anew",
    )
    parser.add_argument(
        "settings",
        nargs="*",
        metavar="KEY=VALUE",
        help="with set: " + ", ".join(key.name.lower() for key in ConfigKey),
    )
    parser.add_argument(
        "--node-id", type=whole(0, 255), metavar="N", help="which node, where several share the line"
    )
    parser.add_argument(
        "--baud", type=baud, default=UART_BAUD, help=f"of a serial port (default {UART_BAUD})"
    )
    parser.add_argument(
        "--kind",
        choices=[kind.name.lower() for kind in BiasKind],
        help="with bias: what is known of the rate, stored as bias_kind (default: as it is stored)",
    )
    parser.add_argument(
        "--samples",
        type=whole(0, 1_000_000_000),
        default=_LEAST_SAMPLES,
        help=f"with bias: how many to use, from {_LEAST_SAMPLES} on (default {_LEAST_SAMPLES})",
    )
    add_udp_arguments(parser)
    parser.add_argument("--repl", action="store_true", help="with reboot: into the MicroPython prompt")


def run(args: argparse.Namespace) -> NodeResult:
    """Does one thing with one node.

    Raises InputError for a setting that does not exist or that the node finds bad, NodeRefused where it says
    no, LinkError where it does not answer.
    """
    wanted = _settings(args)
    port = trusted(parse_port(args.port), args.key_file, insecure=args.insecure_udp)
    with Conversation(port, args.baud, args.node_id) as node:
        with SafeConsole(stderr=True).status(f"{args.port}: waiting for the node") as status:
            met = node.meet()
            if args.action == "set":
                _set(node, wanted)
            elif args.action == "bias":
                for key, value in wanted:
                    node.ask(SetConfig(key, value))
                status.update(f"{args.port}: {args.samples} samples for the bias")
                _find_bias(node, args.samples)
            elif args.action == "reboot":
                status.update(f"{args.port}: waiting for the node to start again")
                node.restart(RebootMode.REPL if args.repl else RebootMode.RUN)
                if not args.repl:
                    node.again(_HELLO_S, met.boot_id)
            if args.action in ("info", "bias"):
                node.wait(lambda: node.health is not None, _HEALTH_S)
                node.wait(lambda: node.filter is not None, _FILTER_S)
        return _result(args, node, {key.name.lower(): value for key, value in wanted})


def _settings(args: argparse.Namespace) -> list[tuple[ConfigKey, int]]:
    if args.action == "set" and not args.settings:
        raise InputError("set: name at least one setting, such as rate_hz=208")
    if args.action != "set" and args.settings:
        raise InputError(f"{args.action}: takes no settings; they belong to set")
    if args.action != "bias" and args.kind is not None:
        raise InputError("--kind belongs to bias")
    if args.repl and args.action != "reboot":
        raise InputError("--repl belongs to reboot")
    if not _LEAST_SAMPLES <= args.samples <= _MOST_SAMPLES:
        raise InputError(f"--samples {args.samples}: from {_LEAST_SAMPLES} to {_MOST_SAMPLES}")
    if args.kind is not None:
        return [(ConfigKey.BIAS_KIND, BiasKind[args.kind.upper()])]
    return [_setting(text) for text in args.settings]


def _setting(text: str) -> tuple[ConfigKey, int]:
    name, found, value = text.partition("=")
    key = ConfigKey.__members__.get(name.strip().upper().replace("-", "_"))
    if key is None or not found:
        known = ", ".join(key.name.lower() for key in ConfigKey)
        raise InputError(f"{text!r}: write KEY=VALUE with one of {known}")
    words = _NAMED[key].__members__ if key in _NAMED else {}
    if value.strip().upper() in words:
        return key, int(words[value.strip().upper()])
    try:
        number = int(value)
    except ValueError:
        choice = " or one of " + ", ".join(map(str.lower, words)) if words else ""
        raise InputError(f"{text!r}: write a whole number{choice}") from None
    if not -(1 << 31) <= number < 1 << 31:
        raise InputError(f"{text!r}: does not fit 32 bits")
    return key, number


def _set(node: Conversation, wanted: list[tuple[ConfigKey, int]]) -> None:
    """Stores settings.

    Those of sampling are put into force by a start, after which the node says what it has taken.
    """
    for key, value in wanted:
        node.ask(SetConfig(key, value))
        if key == ConfigKey.NODE_ID:
            node.now_called(value)
    if any(key in _AT_START for key, _ in wanted):
        node.ask(Start())
    node.meet()


def _find_bias(node: Conversation, samples: int) -> None:
    hello = node.hello
    rate = hello.rate_mhz / 1000 if hello is not None and hello.rate_mhz else 100.0
    node.ask(BiasInit(samples), seconds=3.0 * samples / rate + 5.0, tries=1)
    node.filter = None
    node.wait(lambda: node.filter is not None and node.filter.state == FilterState.TRACKING, _FILTER_S)


def _result(args: argparse.Namespace, node: Conversation, done: dict[str, int]) -> NodeResult:
    assert node.hello is not None and node.node_id is not None
    step = node.hello.gyro_lsb_ndps * RAD_PER_NANO_DEG
    row = None
    if node.filter is not None and step:
        row = seen_row(filter_seen(node.filter, 0, step, 0))
    return NodeResult(args.port, args.action, node.node_id, node.hello, node.health, row, done)


def _fields(health: Health) -> dict[str, int]:
    return {name: getattr(health, name) for name in Health.__slots__}


def _faults(health: Health | None) -> list[str]:
    return [] if health is None else [fault.name.lower() for fault in Fault if fault & health.faults]


def _named(hello: Hello) -> dict[str, str]:
    """Codes by name, and what a log has no need to keep."""
    return {
        "board": known_name(Board, hello.board),
        "reset_cause": known_name(ResetCause, hello.reset_cause),
        "filter_kind": known_name(FilterKind, hello.filter_kind),
        "batch": str(hello.batch),
        "stamp_bound_us": str(hello.stamp_bound_us),
    }
