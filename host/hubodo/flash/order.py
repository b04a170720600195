"""The settings that flashing writes into the /config.json of a board."""

from __future__ import annotations

import ast
import difflib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from hubodo.calibration.file import Calibration
from hubodo.errors import CalibrationError, InputError
from hubodo.flash.image import firmware_folder
from hubodo.flash.node_settings import apply_calibration_to_config
from hubodo.ingest.link.keys import KeyRing
from hubowire import node_name
from hubowire.messages import NODE_IDS, BiasKind

CONFIG = "config.json"
_MAX_RADIO_NODES = 5


@dataclass(frozen=True)
class SettingsOrder:
    """The requested changes to the settings of a board.

    Attributes
    ----------
    settings
        Settings by name, as in firmware/settings.py.
    calibration, path
        Calibration to apply, and its file.
    keys
        Keys for UDP; see `ingest.link.keys`.
    """

    settings: Mapping[str, object] = field(default_factory=dict)
    calibration: Calibration | None = None
    path: Path | None = None
    keys: KeyRing | None = None

    @property
    def has_changes(self) -> bool:
        """Return True if the order changes any setting."""
        return bool(self.settings) or self.calibration is not None or self.keys is not None

    def config(self, present: Mapping[str, object], serial: str) -> dict[str, object]:
        """Return the settings of the board with a serial number, from its present ones.

        Raises InputError if the calibration lacks the node, CalibrationError if it belongs to another board.
        """
        settings = {**present, **self.settings}
        if self.keys is not None:
            settings["key"] = self.keys.get_or_create_key(serial).hex()
        if self.calibration is None:
            _check_heap(settings)
            return settings
        number = settings.get("node_id", 1)
        name = node_name(number if isinstance(number, int) else 1)
        if name not in self.calibration.nodes:
            known = ", ".join(self.calibration.nodes) or "none"
            raise InputError(f"{self.path}: no node {name!r}, only {known}; give --node, or calibrate it")
        node = self.calibration.nodes[name]
        if node.serial and node.serial.lower() != serial.lower():
            raise CalibrationError(
                f"{self.path}: nodes.{name} belongs to the board with serial {node.serial}, this one has "
                f"{serial}; give its own calibration, or another --node"
            )
        settings = apply_calibration_to_config(settings, node)
        _check_heap(settings)
        return settings


def parse_node_id(text: str, context: str = "--node") -> int:
    """Return the node id of a name or number; raise InputError for an invalid one."""
    if text in NODE_IDS:
        return NODE_IDS[text]
    if text.isdigit() and 1 <= int(text) <= 254:
        return int(text)
    raise InputError(f"{context} {text}: use {', '.join(NODE_IDS)} or a number from 1 to 254")


def parse_settings(words: Iterable[str]) -> dict[str, object]:
    """Return settings from NAME=VALUE words, values as JSON where they are valid JSON; raise InputError."""
    settings: dict[str, object] = {}
    types = _setting_types()
    for word in words:
        name, equals, text = word.partition("=")
        if not equals:
            raise InputError(f"--set {word}: write NAME=VALUE, such as link=udp")
        if name not in types:
            near = difflib.get_close_matches(name, types, 1)
            hint = f"; is it {near[0]}?" if near else "; see firmware/README.md"
            raise InputError(f"--set {word}: a node has no setting {name!r}{hint}")
        try:
            value: object = json.loads(text)
        except ValueError:
            value = text
        # A password may look like a number.
        settings[name] = text if types[name] is str else value
        if type(settings[name]) is not types[name]:
            raise InputError(f"--set {word}: {name} must be {types[name].__name__}, see firmware/README.md")
        if name == "radio_nodes" and isinstance(value, list) and len(value) > _MAX_RADIO_NODES:
            raise InputError(
                f"--set {word}: a receiver forwards {_MAX_RADIO_NODES} nodes at most; use a second receiver "
                "on another channel for the others"
            )
    _check_heap(settings)
    return settings


def _check_heap(settings: Mapping[str, object]) -> None:
    """Raise InputError for two choices of which the node would switch one off for lack of heap."""
    for name, is_chosen in (
        ("warmup_udps (of a calibration with a warm-up)", bool(settings.get("warmup_udps"))),
        ("bias_kind 3", settings.get("bias_kind") == BiasKind.GRAVITY),
    ):
        if is_chosen and settings.get("high_g_rate_hz"):
            raise InputError(
                f"high_g_rate_hz and {name}: with both, less than 8 kB of the node's heap would be left; "
                "switch one of them off, such as by --set high_g_rate_hz=0"
            )


def _setting_types() -> dict[str, type]:
    """Return the type of each setting of a node, from its default."""
    types: dict[str, type] = {}
    for name in ("settings.py", "settings_more.py"):
        for line in ast.parse((firmware_folder() / name).read_text()).body:
            if isinstance(line, ast.Assign) and ast.unparse(line.targets[0]) == "DEFAULTS":
                assert isinstance(line.value, ast.Dict)
                pairs = zip(line.value.keys, line.value.values, strict=True)
                types |= {ast.literal_eval(key): _type(value) for key, value in pairs if key is not None}
    return types


def _type(value: ast.expr) -> type:
    """Return the type of a default; a default given by name is an integer of the message table."""
    try:
        return type(ast.literal_eval(value))
    except ValueError:
        return int
