"""TOML files: every key is checked, and written values are read back unchanged."""

import tomllib
from dataclasses import dataclass
from pathlib import Path

import pytest

from hubodo.errors import ConfigError
from hubodo.toml_file import (
    check_positive,
    parse_toml,
    quote_value,
    read_table,
    suggest_spelling,
    toml_key,
    toml_number,
    toml_text,
)


@dataclass(frozen=True)
class Settings:
    rate: float
    count: int = 1
    name: str = ""


def test_a_table_becomes_a_dataclass_and_whole_numbers_become_floats():
    assert read_table({"rate": 2, "name": "a"}, Settings, "file") == Settings(2.0, 1, "a")


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({}, "rate is missing"),
        ({"rate": 1.0, "cuont": 2}, "unknown key 'cuont', did you mean 'count'"),
        ({"rate": "fast"}, "rate = 'fast': must be a number"),
        ({"rate": True}, "must be a number"),
        ({"rate": float("nan")}, "must be a finite number"),
    ],
)
def test_an_invalid_table_is_reported(table, message):
    with pytest.raises(ConfigError, match=message):
        read_table(table, Settings, "file")


@pytest.mark.parametrize("text", ["plain", 'with "quotes" and \\', "new\nline", "\x7f"])
def test_written_keys_and_texts_are_read_back(text):
    assert tomllib.loads(f"{toml_key(text)} = {toml_text(text)}") == {text: text}


def test_written_numbers_keep_all_digits():
    assert tomllib.loads(f"x = {toml_number(0.1 + 0.2)}")["x"] == 0.1 + 0.2


def test_extreme_documents_and_numbers_are_refused():
    with pytest.raises(ConfigError, match="not TOML"):
        parse_toml("x = ", Path("file"))
    with pytest.raises(ConfigError, match="is a file of another format, and a TOML file is due"):
        parse_toml("rostopic: /imu0\n", Path("imu.yaml"))
    with pytest.raises(ConfigError, match="beyond 64 bits"):
        parse_toml(f"x = {1 << 63}", Path("file"))
    for value in (0.0, -1.0, float("inf"), 1e-13, 1e13):
        with pytest.raises(ConfigError):
            check_positive(value, "file x")


def test_errors_quote_the_beginning_of_long_values_and_suggest_similar_words():
    assert len(quote_value("x" * 1000)) < 70
    assert suggest_spelling("speeed", ["speed", "rate"]) == ", did you mean 'speed'?"
    assert suggest_spelling("zzz", ["speed", "rate"]) == ""
