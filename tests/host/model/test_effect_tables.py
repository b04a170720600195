"""Tables of effects in TOML: known effects are read, unknown and refused ones are named with their place."""

import pytest

from hubodo.effects.gyro import GyroBias
from hubodo.errors import ConfigError
from hubodo.model.effect_tables import check_value, effect_heading, read_effect_tables

WHERE = "a.toml: [nodes.left.effects"


def test_each_effect_has_its_class_entries_and_place():
    tables = read_effect_tables({"effects": {"gyro_bias": {"z": 0.1}}}, WHERE, {})
    assert list(tables) == [(GyroBias, {"z": 0.1}, "a.toml: [nodes.left.effects.gyro_bias]")]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("gyro_bais", r"gyro_bais\]: no such effect.*gyro_bias"),
        ("road_grade", r"road_grade\]: road_grade belongs to the vehicle"),
        ("empirical:gz ~ nonsense", "unknown term 'nonsense'"),
    ],
)
def test_an_effect_that_cannot_be_here_is_refused(name, message):
    refusals = {"vehicle": "{name} belongs to the vehicle"}
    with pytest.raises(ConfigError, match=message):
        list(read_effect_tables({"effects": {name: {"k": 1.0}}}, WHERE, refusals))


def test_an_invalid_value_is_refused_with_its_unit():
    check_value(GyroBias, "z", 0.1, "a.toml: [effects.gyro_bias] z")
    with pytest.raises(ConfigError, match=r"z = nan: must be a finite number \(rad/s\)"):
        check_value(GyroBias, "z", float("nan"), "a.toml: [effects.gyro_bias] z")


def test_the_heading_is_a_toml_table():
    assert effect_heading("effects", "gyro_bias") == "[effects.gyro_bias]"
