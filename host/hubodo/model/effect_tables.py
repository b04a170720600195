"""Tables of effects in a TOML file, read and checked: of a model file, and of a calibration alike."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from hubodo.effects import BY_NAME, Effect, effect_of
from hubodo.effects.base import Level
from hubodo.effects.empirical import PREFIX
from hubodo.errors import ConfigError
from hubodo.toml_file import as_table, suggest_spelling, toml_key


def effect_tables(
    table: Mapping[str, Any], where: str, refused: Mapping[Level, str]
) -> Iterator[tuple[type[Effect], dict[str, Any], str]]:
    """Each effect under `effects` of a table, what stands in its own table, and where that is, for errors.

    where: the file and the beginning of the table's name, "FILE: [nodes.left.effects". refused: level -> why
    no effect of it can stand there. Raises ConfigError for an effect that there is not, with the nearest one
    that there is, and for one that is refused.
    """
    for name, values in as_table(table.get("effects", {}), f"{where}]").items():
        here = f"{where}.{toml_key(name)}]"
        if name not in BY_NAME and not name.startswith(PREFIX):
            hint = suggest_spelling(name, BY_NAME)
            raise ConfigError(
                f"{here}: no such effect{hint}; see the table of effects in the model's README, or name the "
                "file that has it with --effects"
            )
        try:
            kind = effect_of(name)
        except ValueError as error:
            raise ConfigError(f"{here}: {error}") from None
        if kind.level in refused:
            raise ConfigError(f"{here}: {refused[kind.level].format(name=name)}")
        yield kind, as_table(values, here), here


def check_value(kind: type[Effect], parameter: str, value: float, where: str) -> None:
    """Raises ConfigError when a parameter cannot have this value. where: file, table and key."""
    says = kind.problem(parameter, value)
    if says:
        raise ConfigError(f"{where} = {value}: {says} ({kind.unit(parameter)})")


def effect_heading(place: str, name: str) -> str:
    """The line above the parameters of an effect; place: "effects", "nodes.left.effects"."""
    return f"[{place}.{toml_key(name)}]"
