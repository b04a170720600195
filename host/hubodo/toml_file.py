"""TOML files read into dataclasses with every key checked, and TOML values written."""

from __future__ import annotations

import math
import re
import stat
import tomllib
from collections.abc import Iterable
from dataclasses import MISSING, fields
from pathlib import Path
from types import NoneType
from typing import Any, Literal, TypeVar, cast, get_args, get_origin, get_type_hints

from hubodo.errors import ConfigError
from hubodo.spelling import explain_missing_file, suggest_spelling

_T = TypeVar("_T")
_MAX_TABLE_DEPTH = 20
_MAX_FILE_BYTES = 1 << 20  # a thousand nodes with all effects need half of it
_MCAP_MAGIC = b"\x89MCAP0\r\n"
_MAX_QUOTED_LENGTH = 60  # characters of a value in an error

MAX_TOML_NUMBER = 1e12
"""Largest accepted number, in SI units; nothing larger is meaningful."""


def toml_key(name: str) -> str:
    """Return a name as a TOML key: bare if the characters allow it, else quoted."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else toml_text(name)


def toml_text(text: str) -> str:
    """Return a text as a TOML string on one line; lone surrogates, which TOML lacks, are escaped."""
    text = text.encode("utf-8", "backslashreplace").decode("utf-8")
    escaped = "".join(
        f"\\u{ord(c):04x}" if ord(c) < 32 or ord(c) == 127 else f"\\{c}" if c in '\\"' else c for c in text
    )
    return f'"{escaped}"'


def toml_number(value: float) -> str:
    """Return a float as a TOML number with all its digits."""
    return repr(float(value))


def read_table(table: object, shape: type[_T], where: str) -> _T:
    """Return a TOML table as a frozen dataclass of str, int, float, bool, Literal of texts and lists of str.

    where: file and table, for the error. Raises ConfigError when a key is unknown (with the nearest known
    one) or missing, or its value has another type.
    """
    entries = as_table(table, where)
    hints = get_type_hints(shape)
    items = fields(cast(Any, shape))
    check_known_keys(entries, [item.name for item in items], where)
    values: dict[str, Any] = {}
    for item in items:
        if item.name in entries:
            values[item.name] = _convert_value(entries[item.name], hints[item.name], f"{where} {item.name}")
        elif item.default is MISSING and item.default_factory is MISSING:
            raise ConfigError(f"{where}: {item.name} is missing; add it")
    return shape(**values)


def _convert_value(value: object, hint: Any, where: str) -> Any:
    if NoneType in get_args(hint):
        # TOML has no null: a key that is present has a value.
        (hint,) = (option for option in get_args(hint) if option is not NoneType)
    if hint == tuple[str, ...]:
        if isinstance(value, list) and all(isinstance(entry, str) for entry in value):
            return tuple(value)
        raise ConfigError(f"{where} = {quote_value(value)}: must be a list of texts")
    if get_origin(hint) is Literal:
        if value in get_args(hint):
            return value
        options = get_args(hint)
        raise ConfigError(
            f"{where} = {quote_value(value)}: write {' or '.join(options)}"
            f"{suggest_spelling(str(value), options)}"
        )
    text = str(hint)
    if isinstance(value, bool) or hint is bool:
        if isinstance(value, bool) and "bool" in text:
            return value
    elif (
        isinstance(value, int | float)
        and ("float" in text or "int" in text)
        and not abs(value) <= MAX_TOML_NUMBER
    ):
        raise ConfigError(
            f"{where} = {quote_value(value)}: must be a finite number of {MAX_TOML_NUMBER:g} at most"
        )
    elif isinstance(value, int | float) and "float" in text:
        return float(value)
    elif (isinstance(value, int) and "int" in text) or (isinstance(value, str) and "str" in text):
        return value
    names = {"float": "a number", "int": "a whole number", "bool": "true or false", "str": "a text"}
    expected = next(words for name, words in names.items() if name in text)
    if isinstance(value, str) and "float" in text:
        expected += " in SI units (m, rad, s), without quotation marks"
    raise ConfigError(f"{where} = {quote_value(value)}: must be {expected}")


_OTHER_SUFFIXES = (".yaml", ".yml", ".json", ".xml", ".ini", ".csv", ".urdf")


def load_toml(path: Path) -> dict[str, Any]:
    """Return the document of a TOML file. Raises ConfigError if it is missing, not readable, or not TOML."""
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise ConfigError(f"{path}: is a folder, a pipe or a device; name a TOML file")
        with path.open("rb") as stream:
            if stream.read(len(_MCAP_MAGIC)) == _MCAP_MAGIC:
                raise ConfigError(
                    f"{path}: is a log, and a TOML file is due here; check the order of the arguments"
                )
        if status.st_size > _MAX_FILE_BYTES:
            raise ConfigError(
                f"{path}: has {status.st_size} bytes, settings {_MAX_FILE_BYTES} at most; check the path"
            )
        text = path.read_text("utf-8-sig")
    except FileNotFoundError:
        raise ConfigError(explain_missing_file(path, "no such file; check the path")) from None
    except OSError as error:
        raise ConfigError(
            f"{path}: cannot be read ({error.strerror}); check the path and its rights"
        ) from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: is not UTF-8 text ({error}); check the path") from None
    return parse_toml(text, path)


def parse_toml(text: str, path: Path) -> dict[str, Any]:
    """Return the document in a TOML text; path: its file, for errors. Raises ConfigError for invalid TOML."""
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        if path.suffix.lower() in _OTHER_SUFFIXES:
            raise ConfigError(
                f"{path}: is a file of another format, and a TOML file is due here; hubodo writes them with "
                "vehicle new, calibrate, warmup and config example"
            ) from None
        raise ConfigError(f"{path}: not TOML: {error}; correct that line") from None
    except (ValueError, RecursionError):
        # The parser raises these for a number of thousands of digits and for lists nested too deeply.
        raise ConfigError(f"{path}: not usable TOML: a value is too long or nested too deeply") from None
    _check_size(document, path)
    return document


def _check_size(document: dict[str, Any], path: Path) -> None:
    """Raise ConfigError for integers beyond the 64 bits of TOML, and for tables nested too deeply."""
    pending: list[tuple[str, object, int]] = [("", document, 0)]
    while pending:
        name, value, depth = pending.pop()
        if depth > _MAX_TABLE_DEPTH:
            raise ConfigError(f"{path}: {name[:40]}...: a table within {depth} others; write it flatter")
        if isinstance(value, dict):
            pending += [(f"{name}.{key}".removeprefix("."), inner, depth + 1) for key, inner in value.items()]
        elif isinstance(value, list):
            pending += [(name, inner, depth + 1) for inner in value]
        elif isinstance(value, int) and not -(1 << 63) <= value < 1 << 63:
            raise ConfigError(f"{path}: {name}: a whole number beyond 64 bits; write a smaller one")


def as_table(value: object, where: str) -> dict[str, Any]:
    """Return the value; raise ConfigError if it is not a table. where: file and table, for the error."""
    if isinstance(value, dict):
        return value
    raise ConfigError(f"{where} = {quote_value(value)}: must be a table")


def quote_value(value: object) -> str:
    """Return a value of a file as text for an error, shortened."""
    text = repr(value)
    return text if len(text) <= _MAX_QUOTED_LENGTH else f"{text[:_MAX_QUOTED_LENGTH]}..."


def check_known_keys(table: object, known: Iterable[str], where: str) -> None:
    """Raise ConfigError for the first unknown key; the error names the most similar known one."""
    names = list(known)
    for key in as_table(table, where):
        if key not in names:
            hint = suggest_spelling(key, names)
            raise ConfigError(f"{where}: unknown key {quote_value(key)}{hint}; known are {', '.join(names)}")


def check_positive(value: float, where: str) -> None:
    """Raise ConfigError for a number that is not positive, or whose square would overflow or vanish.

    where: file, table and key.
    """
    if not (math.isfinite(value) and value > 0.0):
        raise ConfigError(f"{where} = {value}: must be a finite number above 0")
    if not 1.0 / MAX_TOML_NUMBER <= value <= MAX_TOML_NUMBER:
        raise ConfigError(f"{where} = {value}: must be from {1.0 / MAX_TOML_NUMBER:g} to {MAX_TOML_NUMBER:g}")
