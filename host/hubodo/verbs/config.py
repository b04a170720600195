"""`hubodo config`: print a commented hubodo.toml, or check one."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from rich.console import Console

from hubodo.atomic_files import write_atomically
from hubodo.errors import ConfigError, InputError
from hubodo.ingest.live.record_config import RecordConfig, load_record_config
from hubodo.ros2.config import Ros2Config, load_ros2_config
from hubodo.settings_table import format_example_toml
from hubodo.toml_file import load_toml
from hubodo.verbs.outputs import add_force_option
from hubodo.web.config import WebConfig, load_web_config

EXAMPLE = "hubodo config example -o hubodo.toml; hubodo config check hubodo.toml"
SETTINGS: dict[str, type] = {"record": RecordConfig, "web": WebConfig, "ros2": Ros2Config}
"""Settings class of each table of hubodo.toml."""
_EXAMPLE_HEADER = """hubodo.toml: settings for `hubodo record --config hubodo.toml`; options override it.
Commented-out lines show what can be set; `hubodo config check hubodo.toml` checks the file.
Paths are relative to this file."""


@dataclass(frozen=True)
class ConfigCheck:
    """A valid settings file, with the settings that differ from their defaults, by table."""

    file: str
    settings: dict[str, dict[str, Any]]

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result."""
        return {"file": self.file, "settings": self.settings}

    def render(self, console: Console) -> None:
        """Print the verdict, then the settings that differ from their defaults."""
        console.print(f"{self.file}: valid", highlight=False)
        for table, settings in self.settings.items():
            for key, value in settings.items():
                console.print(f"  [{table}] {key} = {value}", highlight=False, markup=False)


@dataclass(frozen=True)
class ConfigExample:
    """The text of a commented hubodo.toml; file: where it was written, None to print it."""

    text: str
    file: str | None = None

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result."""
        return {"text": self.text, "file": self.file}

    def render(self, console: Console) -> None:
        """Print the text as it is, or the file that holds it."""
        if self.file is not None:
            console.print(f"{self.file}: written", highlight=False, markup=False)
            return
        console.print(self.text, end="", highlight=False, markup=False, soft_wrap=True)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo config`."""
    parser.add_argument(
        "does",
        metavar="ACTION",
        choices=("example", "check"),
        help="example: print a hubodo.toml with every setting explained; check: check the keys, types and "
        "bounds of FILE, and that the files it names exist",
    )
    parser.add_argument("file", type=Path, nargs="?", metavar="FILE", help="settings file to check")
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="FILE",
        help="file for the example, which is printed otherwise",
    )
    add_force_option(parser, "output")


def run(args: argparse.Namespace) -> ConfigCheck | ConfigExample:
    """Print an example, or check a settings file.

    Returns
    -------
    ConfigCheck or ConfigExample
        The non-default settings of a valid file, or the text of the example.

    Raises
    ------
    InputError
        If FILE is missing for `check`, or given for `example`.
    ConfigError
        If the file is invalid.
    """
    if args.does == "example":
        if args.file is not None:
            raise InputError(f"config example writes a file with -o: hubodo config example -o {args.file}")
        text = format_example_toml(SETTINGS, _EXAMPLE_HEADER)
        if args.output is not None:
            write_atomically(args.output, text)
        return ConfigExample(text, None if args.output is None else str(args.output))
    if args.file is None:
        raise InputError("config check needs a FILE, such as hubodo.toml")
    if args.output is not None:
        raise InputError("config check writes nothing: -o belongs to config example")
    return _check_file(args.file)


def _check_file(path: Path) -> ConfigCheck:
    if "vehicle" in load_toml(path):
        raise ConfigError(
            f"{path}: is a vehicle or model file, and a hubodo.toml is due here; `hubodo vehicle check` "
            "reads vehicle files"
        )
    config = load_record_config(path)
    for key in ("vehicle", "calibration"):
        file = getattr(config, key)
        if file is not None and not (path.parent / file).is_file():
            raise ConfigError(f"{path}: [record] {key} = {file!r}: no such file beside it; check the path")
    tables = {"record": config, "web": load_web_config(path), "ros2": load_ros2_config(path)}
    return ConfigCheck(
        str(path), {name: _non_default_settings(settings) for name, settings in tables.items()}
    )


def _non_default_settings(settings: Any) -> dict[str, Any]:
    """Return the settings that differ from their defaults."""
    return {
        item.name: value
        for item in fields(settings)
        if (value := getattr(settings, item.name)) != item.default
    }
