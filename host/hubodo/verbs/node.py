"""`hubodo node`: identify a node, store settings, initialise its gyro bias, or restart it."""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

from rich.console import Console
from rich.table import Table

from hubodo.errors import InputError
from hubodo.ingest.link.ports import attach_keys, parse_port
from hubodo.ingest.node.bias_filter import decode_filter_report, describe_filter_row, filter_report_row
from hubodo.ingest.node.conversation import Conversation
from hubodo.ingest.node.identity import code_name, hello_metadata
from hubodo.ingest.node.wire_batch import RAD_PER_NANO_DEG
from hubodo.terminal import SafeConsole
from hubodo.verbs.key_options import add_key_arguments, insecure_kinds
from hubodo.verbs.numbers import baud_rate, bounded_integer
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

# Longest wait for each message: health and filter state come about once a second, hello after booting.
_HEALTH_TIMEOUT_S, _FILTER_TIMEOUT_S, _BOOT_TIMEOUT_S = 2.5, 1.5, 15.0
_MIN_BIAS_SAMPLES, _MAX_BIAS_SAMPLES = 2000, 65535
_SAMPLING_KEYS = (ConfigKey.RATE_HZ, ConfigKey.GYRO_RANGE_DPS, ConfigKey.ACCEL_RANGE_G, ConfigKey.BATCH)
_ENUM_OF_KEY: dict[ConfigKey, type[IntEnum]] = {
    ConfigKey.FILTER_KIND: FilterKind,
    ConfigKey.BIAS_KIND: BiasKind,
}


@dataclass(frozen=True)
class NodeResult:
    """The state of a node after an action.

    Attributes
    ----------
    port
        Port as given.
    action
        info, set, bias or reboot.
    node_id
        Id of the node on the wire.
    hello
        Identification: firmware, board, sensor, settings.
    health
        Latest health message, if one was received.
    bias_filter
        Bias as estimated by the node, rad/s, or None.
    stored_settings
        Settings that were stored.
    """

    port: str
    action: str
    node_id: int
    hello: Hello
    health: Health | None = None
    bias_filter: dict[str, float] | None = None
    stored_settings: dict[str, int] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result."""
        health = None if self.health is None else _fields(self.health)
        return {
            "port": self.port,
            "action": self.action,
            "node_id": self.node_id,
            "node": node_name(self.node_id),
            "hello": hello_metadata(self.hello) | _codes_by_name(self.hello),
            "health": health,
            "faults": _faults(self.health),
            "bias_filter": None
            if self.bias_filter is None
            else {key: None if math.isnan(value) else value for key, value in self.bias_filter.items()},
            "done": self.stored_settings,
        }

    def render(self, console: Console) -> None:
        """Print the stored settings, then identification, faults, health and bias."""
        for name, value in self.stored_settings.items():
            console.print(f"{name} = {value}: stored", highlight=False, markup=False)
        title = f"node {self.node_id} ({node_name(self.node_id)}) on {self.port}"
        table = Table(title=title, show_header=False)
        for key, text in (hello_metadata(self.hello) | _codes_by_name(self.hello)).items():
            table.add_row(key, text)
        if self.health is not None:
            table.add_row("faults", ", ".join(_faults(self.health)) or "none")
            for key, value in _fields(self.health).items():
                if key not in ("faults", "reset_cause", "stamp_bound_us"):
                    table.add_row(key, str(value))
        if self.bias_filter is not None:
            table.add_row("bias", describe_filter_row(self.bias_filter))
        console.print(table, highlight=False)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo node`."""
    parser.add_argument(
        "port",
        metavar="PORT",
        help="/dev/..., USB serial number, socket://HOST:PORT (connect), udp://HOST:PORT (listen) or ble://NAME",
    )
    parser.add_argument(
        "action",
        metavar="ACTION",
        choices=("info", "set", "bias", "reboot"),
        help="info: show identification and health; set: store settings; bias: initialise the gyro bias by "
        "the method of --kind; reboot: restart the node",
    )
    parser.add_argument(
        "settings",
        nargs="*",
        default=[],
        metavar="KEY=VALUE",
        help="with set: " + ", ".join(key.name.lower() for key in ConfigKey),
    )
    parser.add_argument(
        "--node-id",
        type=bounded_integer(0, 255),
        metavar="N",
        help="id of the node, if several share the line",
    )
    parser.add_argument(
        "--baud", type=baud_rate, default=UART_BAUD, help=f"baud rate of a serial port (default {UART_BAUD})"
    )
    parser.add_argument(
        "--kind",
        choices=[kind.name.lower() for kind in BiasKind],
        help="with bias: method, by what is known of the true rate; stored as bias_kind (default: as stored)",
    )
    parser.add_argument(
        "--samples",
        type=bounded_integer(0, 1_000_000_000),
        default=_MIN_BIAS_SAMPLES,
        help=f"with bias: number of samples, at least {_MIN_BIAS_SAMPLES} (default {_MIN_BIAS_SAMPLES})",
    )
    add_key_arguments(parser)
    parser.add_argument(
        "--repl", action="store_true", help="with reboot: restart into the MicroPython prompt"
    )


def run(args: argparse.Namespace) -> NodeResult:
    """Perform one action on one node.

    Returns
    -------
    NodeResult
        The state of the node after the action.

    Raises
    ------
    InputError
        If a setting does not exist or the node rejects its value.
    NodeRefused
        If the node refuses the action.
    LinkError
        If the node does not answer.
    """
    requested = _requested_settings(args)
    port = attach_keys(parse_port(args.port), args.key_file, insecure=insecure_kinds(args))
    with Conversation(port, args.baud, args.node_id) as node:
        with SafeConsole(stderr=True).status(f"{args.port}: waiting for the node") as status:
            identification = node.identify()
            if args.action == "set":
                _store_settings(node, requested)
            elif args.action == "bias":
                for key, value in requested:
                    node.request(SetConfig(key, value))
                status.update(f"{args.port}: averaging {args.samples} samples for the bias")
                _initialise_bias(node, args.samples)
            elif args.action == "reboot":
                status.update(f"{args.port}: waiting for the node to restart")
                node.restart_node(RebootMode.REPL if args.repl else RebootMode.RUN)
                if not args.repl:
                    node.wait_for_restart(_BOOT_TIMEOUT_S, identification.boot_id)
            if args.action in ("info", "bias"):
                node.wait_until(lambda: node.health is not None, _HEALTH_TIMEOUT_S)
                node.wait_until(lambda: node.filter is not None, _FILTER_TIMEOUT_S)
        return _result(args, node, {key.name.lower(): value for key, value in requested})


def _requested_settings(args: argparse.Namespace) -> list[tuple[ConfigKey, int]]:
    if args.action == "set" and not args.settings:
        raise InputError("set: give at least one setting, such as rate_hz=208")
    if args.action != "set" and args.settings:
        raise InputError(f"{args.action}: takes no settings; they belong to set")
    if args.action != "bias" and args.kind is not None:
        raise InputError("--kind belongs to bias")
    if args.repl and args.action != "reboot":
        raise InputError("--repl belongs to reboot")
    if not _MIN_BIAS_SAMPLES <= args.samples <= _MAX_BIAS_SAMPLES:
        raise InputError(f"--samples {args.samples}: from {_MIN_BIAS_SAMPLES} to {_MAX_BIAS_SAMPLES}")
    if args.kind is not None:
        return [(ConfigKey.BIAS_KIND, BiasKind[args.kind.upper()])]
    return [_parse_setting(text) for text in args.settings]


def _parse_setting(text: str) -> tuple[ConfigKey, int]:
    name, equals, value = text.partition("=")
    key = ConfigKey.__members__.get(name.strip().upper().replace("-", "_"))
    if key is None or not equals:
        known = ", ".join(key.name.lower() for key in ConfigKey)
        raise InputError(f"{text!r}: write KEY=VALUE with one of {known}")
    words = _ENUM_OF_KEY[key].__members__ if key in _ENUM_OF_KEY else {}
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


def _store_settings(node: Conversation, requested: list[tuple[ConfigKey, int]]) -> None:
    """Store settings in the node.

    Sampling settings take effect at a new start of sampling, after which the node reports what it uses.
    """
    for key, value in requested:
        node.request(SetConfig(key, value))
        if key == ConfigKey.NODE_ID:
            node.set_node_id(value)
    if any(key in _SAMPLING_KEYS for key, _ in requested):
        node.request(Start())
    node.identify()


def _initialise_bias(node: Conversation, samples: int) -> None:
    hello = node.hello
    rate = hello.rate_mhz / 1000 if hello is not None and hello.rate_mhz else 100.0
    node.request(BiasInit(samples), timeout_s=3.0 * samples / rate + 5.0, attempts=1)
    node.filter = None
    node.wait_until(
        lambda: node.filter is not None and node.filter.state == FilterState.TRACKING, _FILTER_TIMEOUT_S
    )


def _result(args: argparse.Namespace, node: Conversation, done: dict[str, int]) -> NodeResult:
    assert node.hello is not None and node.node_id is not None
    step = node.hello.gyro_lsb_ndps * RAD_PER_NANO_DEG
    row = None
    if node.filter is not None and step:
        row = filter_report_row(decode_filter_report(node.filter, 0, step, 0))
    return NodeResult(args.port, args.action, node.node_id, node.hello, node.health, row, done)


def _fields(health: Health) -> dict[str, int]:
    return {name: getattr(health, name) for name in Health.__slots__}


def _faults(health: Health | None) -> list[str]:
    return [] if health is None else [fault.name.lower() for fault in Fault if fault & health.faults]


def _codes_by_name(hello: Hello) -> dict[str, str]:
    """Return enumerated codes by name, and identification fields that a log does not store."""
    return {
        "board": code_name(Board, hello.board),
        "reset_cause": code_name(ResetCause, hello.reset_cause),
        "filter_kind": code_name(FilterKind, hello.filter_kind),
        "batch": str(hello.batch),
        "stamp_bound_us": str(hello.stamp_bound_us),
    }
