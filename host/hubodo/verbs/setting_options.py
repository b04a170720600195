"""Options of the command line made from the fields of a settings class: meaning, default and bounds."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from dataclasses import Field, fields
from functools import cache
from types import NoneType
from typing import Any, Literal, get_args, get_origin, get_type_hints

from hubodo.settings_table import describe_default
from hubodo.toml_file import MAX_TOML_NUMBER
from hubodo.verbs.numbers import bounded_integer, bounded_number


def add_setting_option(
    parser: argparse.ArgumentParser,
    settings: type,
    name: str,
    *flags: str,
    parse: Callable[[str], object] | None = None,
) -> None:
    """Add the option of a setting, `--name` with hyphens; its value is None, or False, if it is not given.

    settings: class whose fields are made by `hubodo.settings_table.setting`. flags: further names of the
    option. parse: type of the value; by default that of the field, within its bounds.
    """
    item, hint = _find_field(settings, name)
    flags = (*flags, f"--{name.replace('_', '-')}")
    options: dict[str, Any] = {"help": setting_help(settings, name)}
    if hint is bool:
        options["action"] = "store_true"
    else:
        options["metavar"] = item.metadata["metavar"]
    if get_origin(hint) is Literal:
        options["choices"] = get_args(hint)
    if parse is not None or hint in (int, float):
        options["type"] = parse or _number_type(hint, item.metadata)
    parser.add_argument(*flags, **options)


def setting_help(settings: type, name: str) -> str:
    """Return the meaning of a setting and its default in the style of `--help`."""
    item, hint = _find_field(settings, name)
    # A switch is off unless it is given.
    meaning: str = item.metadata["says"].removesuffix(".") + ("" if hint is bool else describe_default(item))
    # Acronyms and placeholders such as HOST:PORT stay as they are.
    lowered = meaning if meaning[:2].isupper() else meaning[0].lower() + meaning[1:]
    return lowered.replace("%", "%%")


def _find_field(settings: type, name: str) -> tuple[Field[Any], Any]:
    """Return the field of a setting and the type of its values, without None."""
    item = next(item for item in fields(settings) if item.name == name)
    hint = _type_hints(settings)[name]
    present = [option for option in get_args(hint) if option is not NoneType]
    return item, present[0] if NoneType in get_args(hint) else hint


@cache
def _type_hints(settings: type) -> dict[str, Any]:
    """Return the types of all settings of a class, which must be evaluated from texts."""
    return get_type_hints(settings)


def _number_type(hint: type, bounds: Mapping[str, Any]) -> Callable[[str], float]:
    """Return the type of an option for a number; bounds: metadata of its field."""
    least, above = bounds["least"], bounds["above"]
    most = MAX_TOML_NUMBER if bounds["most"] is None else bounds["most"]
    low = -MAX_TOML_NUMBER if least is None else least
    if hint is int:
        return bounded_integer(int(low if above is None else above + 1), int(most))
    return bounded_number(low, most, above=above)
