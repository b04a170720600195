"""Settings dataclasses: bounds are checked, and the example file explains every setting."""

import tomllib
from dataclasses import dataclass

import pytest

from hubodo.errors import ConfigError
from hubodo.settings_table import check_bounds, format_example_toml, setting


@dataclass(frozen=True)
class Web:
    port: int = setting(8000, "port of the page", at_least=1, at_most=65535)
    rate: float | None = setting(None, "Hz at most", example=10.0, above=0.0)
    hosts: tuple[str, ...] = setting((), "allowed hosts", example=("a", "b"))


def test_a_value_out_of_bounds_is_named_as_the_user_knows_it():
    check_bounds(Web(), "--{}".format)
    for settings, message in (
        (Web(port=0), "--port 0: must be at least 1"),
        (Web(port=65536), "--port 65536: must be at most 65535"),
        (Web(rate=0.0), "--rate 0.0: must be above 0"),
        (Web(rate=float("inf")), "and finite"),
    ):
        with pytest.raises(ConfigError, match=message):
            check_bounds(settings, "--{}".format)


def test_the_example_changes_nothing_and_is_valid_uncommented():
    text = format_example_toml({"web": Web}, "Head.")
    assert tomllib.loads(text) == {"web": {}}
    lines = [line.removeprefix("#") if "=" in line else line for line in text.splitlines()]
    assert tomllib.loads("\n".join(lines)) == {"web": {"port": 8000, "rate": 10, "hosts": ["a", "b"]}}
    assert "# port of the page (default: 8000)" in text
