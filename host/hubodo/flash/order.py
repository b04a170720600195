"""What a board is to become: the settings that flashing writes into its /config.json."""

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
from hubodo.flash.node_settings import merged
from hubodo.ingest.link.keys import KeyRing
from hubowire import node_name
from hubowire.messages import NODE_IDS

CONFIG = "config.json"


@dataclass(frozen=True)
class Order:
    """settings: by name, as of firmware/settings.py. calibration: of `path`. keys: see `ingest.link.keys`."""

    settings: Mapping[str, object] = field(default_factory=dict)
    calibration: Calibration | None = None
    path: Path | None = None
    keys: KeyRing | None = None

    @property
    def changes(self) -> bool:
        """Whether the board's settings are touched at all."""
        return bool(self.settings) or self.calibration is not None or self.keys is not None

    def config(self, before: Mapping[str, object], serial: str) -> dict[str, object]:
        """The settings of the board with that serial, from those that it has.

        Raises InputError when the calibration has no such node, CalibrationError when it is of another board.
        """
        made = {**before, **self.settings}
        if self.keys is not None:
            made["key"] = self.keys.get_or_create_key(serial).hex()
        if self.calibration is None:
            return made
        number = made.get("node_id", 1)
        name = node_name(number if isinstance(number, int) else 1)
        if name not in self.calibration.nodes:
            known = ", ".join(self.calibration.nodes) or "none"
            raise InputError(
                f"{self.path}: no node {name!r}, only {known}; give --node, or calibrate this one"
            )
        node = self.calibration.nodes[name]
        if node.serial and node.serial.lower() != serial.lower():
            raise CalibrationError(
                f"{self.path}: nodes.{name} is of the board with serial {node.serial}, this one has "
                f"{serial}; give its own calibration, or another --node"
            )
        return merged(made, node)


def node_id(text: str, where: str = "--node") -> int:
    """The number behind a node's name. Raises InputError for a name that is none."""
    if text in NODE_IDS:
        return NODE_IDS[text]
    if text.isdigit() and 1 <= int(text) <= 254:
        return int(text)
    raise InputError(f"{where} {text}: use {', '.join(NODE_IDS)} or a number from 1 to 254")


def settings_of(words: Iterable[str]) -> dict[str, object]:
    """NAME=VALUE of the command line, values as JSON where they are some. Raises InputError."""
    found: dict[str, object] = {}
    known = _known()
    for word in words:
        name, equals, text = word.partition("=")
        if not equals:
            raise InputError(f"--set {word}: write NAME=VALUE, such as link=udp")
        if name not in known:
            near = difflib.get_close_matches(name, known, 1)
            hint = f"; is it {near[0]}?" if near else "; see firmware/README.md"
            raise InputError(f"--set {word}: a node has no setting {name!r}{hint}")
        try:
            value: object = json.loads(text)
        except ValueError:
            value = text
        # A password may look like a number.
        found[name] = text if known[name] is str else value
        if type(found[name]) is not known[name]:
            raise InputError(f"--set {word}: {name} wants {known[name].__name__}, as firmware/README.md says")
    return found


def _known() -> dict[str, type]:
    """The settings of a node with the type of their defaults."""
    known: dict[str, type] = {}
    for name in ("settings.py", "settings_more.py"):
        for line in ast.parse((firmware_folder() / name).read_text()).body:
            if isinstance(line, ast.Assign) and ast.unparse(line.targets[0]) == "DEFAULTS":
                assert isinstance(line.value, ast.Dict)
                pairs = zip(line.value.keys, line.value.values, strict=True)
                known |= {ast.literal_eval(key): _type(value) for key, value in pairs if key is not None}
    return known


def _type(value: ast.expr) -> type:
    """Of a default; one that is a name is a number of the message table."""
    try:
        return type(ast.literal_eval(value))
    except ValueError:
        return int
