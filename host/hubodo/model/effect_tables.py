"""Tables of effects in TOML files, read and validated for model files and calibration files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from hubodo.effects import BY_NAME, Effect, effect_of
from hubodo.effects.base import Level
from hubodo.effects.empirical import PREFIX
from hubodo.errors import ConfigError
from hubodo.spelling import suggest_spelling
from hubodo.toml_file import as_table, toml_key


def read_effect_tables(
    table: Mapping[str, Any], where: str, refusals: Mapping[Level, str]
) -> Iterator[tuple[type[Effect], dict[str, Any], str]]:
    """Yield the class, the entries and the location (for errors) of each effect under `effects` of a table.

    Parameters
    ----------
    table : table of a vehicle or a node.
    where : file and start of the table name, such as "FILE: [nodes.left.effects".
    refusals : reason why effects of a level are not allowed here, by level.

    Raises
    ------
    ConfigError
        If an effect is unknown or not allowed.
    """
    for name, values in as_table(table.get("effects", {}), f"{where}]").items():
        here = f"{where}.{toml_key(name)}]"
        if name not in BY_NAME and not name.startswith(PREFIX):
            hint = suggest_spelling(name, BY_NAME)
            raise ConfigError(
                f"{here}: no such effect{hint}; see the table of effects in the README of the model, or "
                "name the file that defines it with --effects"
            )
        try:
            kind = effect_of(name)
        except ValueError as error:
            raise ConfigError(f"{here}: {error}") from None
        if kind.level in refusals:
            raise ConfigError(f"{here}: {refusals[kind.level].format(name=name)}")
        yield kind, as_table(values, here), here


def check_value(kind: type[Effect], parameter: str, value: float, where: str) -> None:
    """Raise ConfigError if a parameter cannot have this value; where: file, table and key."""
    reason = kind.invalid_reason(parameter, value)
    if reason:
        raise ConfigError(f"{where} = {value}: {reason} ({kind.unit(parameter)})")


def effect_heading(parent: str, name: str) -> str:
    """Return the heading of the table of an effect; parent: "effects" or "nodes.left.effects"."""
    return f"[{parent}.{toml_key(name)}]"
