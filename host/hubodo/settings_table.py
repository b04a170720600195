"""Settings dataclasses whose fields hold meaning, example and bounds in addition to type and default."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import Field, field, fields
from typing import Any, cast

from hubodo.errors import ConfigError
from hubodo.toml_file import toml_key, toml_number, toml_text

_MAX_LINE_LENGTH = 100


def setting(
    default: Any,
    meaning: str,
    *,
    example: Any = None,
    above: float | None = None,
    at_least: float | None = None,
    at_most: float | None = None,
    metavar: str | None = None,
) -> Any:
    """Return a field of a settings dataclass.

    meaning: explanation with the unit, for hubodo.toml and the command line; the default is appended to it.
    example: value shown in the example file in place of the default. above, at_least, at_most: bounds of a
    number, which must also be finite. metavar: placeholder of the value on the command line.
    """
    return field(
        default=default,
        metadata={
            "says": meaning,
            "example": example,
            "above": above,
            "least": at_least,
            "most": at_most,
            "metavar": metavar,
        },
    )


def describe_default(item: Field[Any]) -> str:
    """Return " (default: ...)" for a setting; "" if it has no default."""
    return "" if item.default in (None, ()) else f" (default: {_format_value(item.default)})"


def check_bounds(settings: object, name_of: Callable[[str], str]) -> None:
    """Raise ConfigError for the first number beyond its bounds.

    name_of: function from the name of a field to the name that the user knows, for the error.
    """
    for item in fields(cast(Any, settings)):
        above, at_least, at_most = (item.metadata.get(bound) for bound in ("above", "least", "most"))
        value = getattr(settings, item.name)
        if value is None or (above is None and at_least is None):
            continue
        if not math.isfinite(value) or (above is not None and not value > above):
            bound = f"above {above:g}" if above is not None else f"at least {at_least:g}"
            raise ConfigError(f"{name_of(item.name)} {value}: must be {bound}, and finite")
        if at_least is not None and value < at_least:
            raise ConfigError(f"{name_of(item.name)} {value}: must be at least {at_least:g}")
        if at_most is not None and value > at_most:
            raise ConfigError(f"{name_of(item.name)} {value}: must be at most {at_most:g}")


def format_example_toml(tables: Mapping[str, type], head: str) -> str:
    """Return the text of a TOML file with every setting explained and commented out."""
    lines = [f"# {line}" for line in head.splitlines()]
    for name, shape in tables.items():
        lines += ["", f"[{name}]"]
        for item in fields(shape):
            example = item.metadata.get("example")
            example = item.default if example is None else example
            lines += [
                "",
                *textwrap.wrap(
                    item.metadata["says"] + describe_default(item),
                    _MAX_LINE_LENGTH,
                    initial_indent="# ",
                    subsequent_indent="# ",
                ),
            ]
            lines.append(f"#{toml_key(item.name)} = {_format_value(example)}")
    return "\n".join(lines) + "\n"


def _format_value(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return toml_text(value)
    if isinstance(value, tuple):
        return f"[{', '.join(map(_format_value, value))}]"
    if isinstance(value, int):
        return str(value)
    assert isinstance(value, float)
    return (
        toml_number(value).removesuffix(".0")
        if value.is_integer() and abs(value) < 1e15
        else toml_number(value)
    )
