"""Mutate CSV and TOML at meaningful places: cells, rows, headers; values, keys, tables."""

from __future__ import annotations

import copy
import random
from typing import Any

CELLS = (
    "nan", "inf", "-inf", "1e300", "-1e300", "1e999", "1e-320", "-0", "", " ", '"', '""', '"1', "1_0", "٣",
    "0x1", "#", "1,5", "9" * 400, "1e", "--1", "+1", "1.5.2", "\x00", "\ufeff1", "true", "1d0",
    "2147483648", "-2147483649",
    "9223372036854775808", "4503599627370497.5", "0.1234567890123456789",
)  # fmt: skip
VALUES: tuple[Any, ...] = (
    float("nan"), float("inf"), 1e300, -1e300, 5e-324, 0, 0.0, -1, 1, 10**400, -(10**30), "", "left",
    "nodes.left.gz",
    "reference.speed", "1", "NaN", [], [1], ["x"], {}, True, False, {"x": 1}, "frame.gz", 1e-9, 1e9,
    "é\n\"\\",
    [[[[]]]], {"value": 1.0, "sigma": 0.1}, {"value": float("nan"), "sigma": -1},
)  # fmt: skip


def mutated_csv(rng: random.Random, text: str) -> bytes:
    """Return a CSV file with changed cells, rows or header."""
    lines = text.rstrip("\n").split("\n")
    for _ in range(rng.randint(1, 4)):
        _change_rows(rng, lines)
    end = rng.choice(("\n", "\n", "\n", "\r\n", "\r", "\n\n", ""))
    data = (end.join(lines) + rng.choice((end, "", "\n"))).encode("utf-8", "surrogatepass")
    if rng.random() < 0.06:
        data = b"\xef\xbb\xbf" + data
    if rng.random() < 0.06 and data:
        at = rng.randrange(len(data))
        data = data[:at] + bytes([rng.randrange(256)]) + data[at + 1 :]
    return data


def _change_rows(rng: random.Random, lines: list[str]) -> None:
    if not lines:
        return
    at, choice = rng.randrange(len(lines)), rng.random()
    cells = lines[at].split(",")
    if choice < 0.45:
        cells[rng.randrange(len(cells))] = rng.choice(CELLS)
    elif choice < 0.5:
        cells[rng.randrange(len(cells))] = "1" * rng.choice((200, 140_000))
    elif choice < 0.55:
        cells.insert(rng.randrange(len(cells) + 1), "1")
    elif choice < 0.6:
        del cells[rng.randrange(len(cells))]
    elif choice < 0.7:
        names = lines[0].split(",")
        names[rng.randrange(len(names))] = rng.choice(
            ("t", "x", "gx", "", '"', "temperature", " t ", "sigma", "#")
        )
        lines[0] = ",".join(names)
        return
    elif choice < 0.75:
        lines.insert(at, lines[rng.randrange(len(lines))])
        return
    elif choice < 0.8:
        del lines[1 + rng.randrange(3) :]
        return
    elif choice < 0.84:
        del lines[at]
        return
    elif choice < 0.88:
        column = rng.randrange(len(cells))
        value = rng.choice(("0", "1e300", "1", "-1e-300", "1e160"))
        lines[1:] = [_with(line, column, value) for line in lines[1:]]
        return
    elif choice < 0.92:
        # Use a unit other than seconds, or calendar times.
        factor, shift = rng.choice(
            ((1e3, 0.0), (1e9, 0.0), (1e-6, 0.0), (1.0, 1.7e9), (-1.0, 0.0), (1.0, 2**31 - 20.0))
        )
        lines[1:] = [_with(line, 0, repr(_number(line) * factor + shift)) for line in lines[1:]]
        return
    else:
        lines.insert(at, rng.choice(("", "#", "# comment", ",,,,,,", " ")))
        return
    lines[at] = ",".join(cells)


def _with(line: str, column: int, value: str) -> str:
    cells = line.split(",")
    if column < len(cells):
        cells[column] = value
    return ",".join(cells)


def _number(line: str) -> float:
    try:
        return float(line.split(",")[0])
    except ValueError:
        return 0.0


def mutated_toml(rng: random.Random, document: dict[str, Any]) -> bytes:
    """Return a document with changed values, keys or text."""
    document = _copied(document)
    for _ in range(rng.randint(1, 3)):
        _change_table(rng, document)
    text = toml_text(document)
    choice = rng.random()
    if choice < 0.1 and text:
        at = rng.randrange(len(text))
        text = (
            text[:at]
            + rng.choice(("=", "[", "]", '"', "\n", "\x00", "#", "'", "1e999", ".", "[" * 2000))
            + text[at:]
        )
    elif choice < 0.14:
        text += "\nx = " + "[" * 3000 + "]" * 3000 + "\n"
    elif choice < 0.18:
        text += "\n" + "a." * 1500 + "a = 1\n"
    elif choice < 0.2:
        text += "\nn = " + "9" * 5000 + "\n"
    data = text.encode("utf-8", "surrogatepass")
    if rng.random() < 0.04 and data:
        at = rng.randrange(len(data))
        data = data[:at] + bytes([rng.randrange(256)]) + data[at + 1 :]
    return data


def _copied(table: dict[str, Any]) -> dict[str, Any]:
    return {key: _copied(value) if isinstance(value, dict) else value for key, value in table.items()}


def _change_table(rng: random.Random, table: dict[str, Any]) -> None:
    while table:
        key = rng.choice(list(table))
        inner = table[key]
        if isinstance(inner, dict) and inner and rng.random() < 0.8:
            table = inner
            continue
        choice = rng.random()
        if isinstance(inner, float) and choice < 0.5:
            # Another size or sign is still a number, so it reaches the computation.
            table[key] = inner * rng.choice((1e-9, 1e-3, 0.1, 10.0, 1e3, 1e9, -1.0))
        elif choice < 0.7:
            table[key] = copy.deepcopy(rng.choice(VALUES))
        elif choice < 0.8:
            del table[key]
        elif choice < 0.9 and inner is not table:
            table[rng.choice(("x", "left", "", "a.b", "z", "sigma", "error", "nodes", "effects"))] = (
                copy.deepcopy(inner)
            )
        else:
            table[key] = {key: inner}
        return


def toml_text(document: dict[str, Any]) -> str:
    """Return the document as inline tables, which can hold any value."""
    return "".join(f"{_key(key)} = {_value(value)}\n" for key, value in document.items())


def _key(name: str) -> str:
    return '"' + name.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n") + '"'


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_key(key)} = {_value(inner)}" for key, inner in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_value, value)) + "]"
    return _key(value) if isinstance(value, str) else repr(value)
