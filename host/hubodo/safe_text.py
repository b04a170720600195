"""Text from users and files in a form that every terminal, encoding and JSON parser accepts."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from typing import Any

_UNSAFE = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
"""Control characters except tab and line feed, overrides of the writing direction, lone surrogates."""
_LONE_SURROGATE = re.compile("[\ud800-\udfff]")


def printable(text: str) -> str:
    r"""Return the text with control characters and lone surrogates escaped as in ``\x1b``."""
    return text if text.isprintable() else _UNSAFE.sub(_escaped, text)


def json_text(
    value: object,
    *,
    indent: int | None = None,
    ascii_only: bool = True,
    compact: bool = False,
    sort: bool = False,
) -> str:
    """Return a value as JSON that any parser reads; all JSON of the package is written by this function.

    JSON has no NaN and no infinity: they become null. Lone surrogates are escaped, numpy scalars and arrays
    become numbers and lists, and other types, such as paths, become their text.
    """
    separators = (",", ":") if compact else None
    return json.dumps(
        json_value(value),
        indent=indent,
        ensure_ascii=ascii_only,
        separators=separators,
        sort_keys=sort,
        allow_nan=False,
    )


def json_value(value: Any) -> Any:
    """Return a value as JSON can hold it: numbers that are not finite become None, other types their text."""
    if value is None or isinstance(value, bool | int):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, str):
        return _LONE_SURROGATE.sub(_escaped, value)
    if isinstance(value, Mapping):
        return {_key(key): json_value(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [json_value(item) for item in value]
    if hasattr(value, "tolist"):  # a numpy scalar or array
        return json_value(value.tolist())
    return json_value(str(value))


def _key(key: object) -> str:
    if isinstance(key, str):
        return _LONE_SURROGATE.sub(_escaped, key)
    return json.dumps(key) if key is None or isinstance(key, bool | int | float) else str(key)


def _escaped(match: re.Match[str]) -> str:
    return match.group().encode("unicode_escape").decode("ascii")
