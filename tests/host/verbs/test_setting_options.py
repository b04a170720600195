"""Options of the command line that are made from the fields of a settings class."""

import argparse
from dataclasses import dataclass
from typing import Literal

import pytest

from hubodo.ingest.live.record_config import RecordConfig
from hubodo.settings_table import format_example_toml, setting
from hubodo.verbs.record import add_arguments
from hubodo.verbs.setting_options import add_setting_option, setting_help


@dataclass(frozen=True)
class Kiln:
    """Settings of every type that an option can have."""

    door_open: bool = setting(False, "Open the door.")
    fuel: Literal["gas", "wood"] = setting("gas", "Fuel of the kiln.")
    shelves: int = setting(3, "Number of shelves.", above=0, at_most=9, metavar="N")
    vents: int = setting(0, "Number of open vents.", at_least=0, metavar="N")
    ramp: float | None = setting(None, "K/s; 50 % is usual.", above=0, metavar="RATE")
    cone: str | None = setting(None, "HOST:PORT of the pyrometer.", metavar="HOST:PORT")


def parse(*words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser(exit_on_error=False)
    for name in ("door_open", "fuel", "shelves", "vents", "ramp", "cone"):
        add_setting_option(parser, Kiln, name, *(("-n",) if name == "shelves" else ()))
    return parser.parse_args(words)


def test_an_option_that_is_not_given_leaves_the_setting_alone() -> None:
    absent = dict.fromkeys(("fuel", "shelves", "vents", "ramp", "cone"))
    assert vars(parse()) == {"door_open": False, **absent}


def test_an_option_has_the_type_of_its_setting() -> None:
    given = parse(
        "--door-open", "--fuel", "wood", "-n", "9", "--vents", "0", "--ramp", "0.5", "--cone", "a:1"
    )
    values = {"fuel": "wood", "shelves": 9, "vents": 0, "ramp": 0.5, "cone": "a:1"}
    assert vars(given) == {"door_open": True, **values}


@pytest.mark.parametrize(
    "words", [["-n", "0"], ["-n", "10"], ["-n", "2.5"], ["--vents", "-1"], ["--ramp", "0"], ["--fuel", "oil"]]
)
def test_an_option_refuses_values_outside_the_bounds_of_its_setting(words: list[str]) -> None:
    with pytest.raises(argparse.ArgumentError, match=words[0]):
        parse(*words)


def test_the_help_of_an_option_is_the_meaning_of_its_setting_and_its_default() -> None:
    assert setting_help(Kiln, "door_open") == "open the door"
    assert setting_help(Kiln, "shelves") == "number of shelves (default: 3)"
    assert setting_help(Kiln, "ramp") == "K/s; 50 %% is usual"
    assert setting_help(Kiln, "cone") == "HOST:PORT of the pyrometer"


def test_record_and_its_settings_file_give_the_same_meaning_and_default_of_a_setting() -> None:
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    example = " ".join(format_example_toml({"record": RecordConfig}, "").replace("\n# ", " ").split())
    by_name = {action.dest: action.help or "" for action in parser._actions}
    for name in ("output", "baud", "rotate_after", "disk_budget_mb", "metrics", "key_file"):
        meaning = by_name[name].removesuffix(")").split(" (default: ")
        assert all(part[1:] in example for part in meaning), name
