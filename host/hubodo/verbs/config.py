"""`hubodo config`: a commented hubodo.toml, and whether one is right."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from rich.console import Console

from hubodo.errors import ConfigError, InputError
from hubodo.ingest.live.record_config import RecordConfig, load_record_config
from hubodo.settings_table import write_example_toml
from hubodo.web.config import WebConfig, load_web_config

EXAMPLE = "hubodo config example > hubodo.toml; hubodo config check hubodo.toml"
SETTINGS: dict[str, type] = {"record": RecordConfig, "web": WebConfig}
"""By table of hubodo.toml."""
_HEAD = """hubodo.toml: settings for `hubodo record --config hubodo.toml`; the command line goes before them.
Every line that is commented out shows what may be said; `hubodo config check hubodo.toml` looks it over."""


@dataclass(frozen=True)
class Checked:
    """A file that is right: by table, the settings that are not the default."""

    file: str
    settings: dict[str, dict[str, Any]]

    def as_json(self) -> dict[str, Any]:
        return {"file": self.file, "settings": self.settings}

    def render(self, console: Console) -> None:
        console.print(f"{self.file}: right", highlight=False)
        for table, settings in self.settings.items():
            for key, value in settings.items():
                console.print(f"  [{table}] {key} = {value}", highlight=False, markup=False)


@dataclass(frozen=True)
class Example:
    """The text of the commented file."""

    text: str

    def as_json(self) -> dict[str, Any]:
        return {"text": self.text}

    def render(self, console: Console) -> None:
        console.print(self.text, end="", highlight=False, markup=False, soft_wrap=True)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What to do, and with which file."""
    parser.add_argument(
        "does",
        choices=("example", "check"),
        help="example: print a hubodo.toml with every setting explained; check: whether a FILE is right: "
        "its keys, types and bounds, and whether the files that it names are there",
    )
    parser.add_argument("file", type=Path, nargs="?", metavar="FILE", help="to be checked")


def run(args: argparse.Namespace) -> Checked | Example:
    """Shows an example or checks a file."""
    if args.does == "example":
        if args.file is not None:
            raise InputError(
                "config example prints to the terminal; redirect it: hubodo config example > FILE"
            )
        return Example(write_example_toml(SETTINGS, _HEAD))
    if args.file is None:
        raise InputError("config check needs a FILE, such as hubodo.toml")
    return _checked(args.file)


def _checked(path: Path) -> Checked:
    config = load_record_config(path)
    for key in ("vehicle", "calibration"):
        named = getattr(config, key)
        if named is not None and not (path.parent / named).is_file():
            raise ConfigError(f"{path}: [record] {key} = {named!r}: no such file beside it; check the path")
    tables = {"record": config, "web": load_web_config(path)}
    return Checked(str(path), {name: _told(settings) for name, settings in tables.items()})


def _told(settings: Any) -> dict[str, Any]:
    """What is not the default."""
    return {
        item.name: value
        for item in fields(settings)
        if (value := getattr(settings, item.name)) != item.default
    }
