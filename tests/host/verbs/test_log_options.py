"""Options that interpret a log of another program: topics, units, columns, memory."""

import argparse
from pathlib import Path

import pytest

from hubodo.errors import InputError
from hubodo.log.number_recording import IMU_CHANNELS
from hubodo.recording import Recording
from hubodo.vehicle import Vehicle, load_vehicle
from hubodo.verbs.log_options import add_log_options, channel_numbers, check_nodes, stated_input_format
from hubodo.verbs.parser import Parser
from vehicles import vehicle_toml


def _parse(*words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_log_options(parser)
    return parser.parse_args(words)


@pytest.fixture
def vehicle(tmp_path: Path) -> Vehicle:
    """A vehicle whose file assigns a topic to its left node."""
    path = tmp_path / "vehicle.toml"
    path.write_text(vehicle_toml(0.165, 0.55) + '[topics]\nleft = "/imu/configured"\n')
    return load_vehicle(path)


def test_without_options_the_format_of_the_log_is_not_overridden() -> None:
    form = stated_input_format(_parse())
    assert (form.rate, form.units, form.columns, form.channel) == (None, (), (), "gz")
    assert dict(form.topic_selection.explicit) == {}


def test_options_are_passed_on_with_blanks_around_names_removed() -> None:
    form = stated_input_format(
        _parse(
            "--rate",
            "208",
            "--unit",
            "deg/s",
            "--unit",
            "g",
            "--columns",
            "t, gz ,-",
            "--topic",
            " left = /a/b ",
        )
    )
    assert (form.rate, form.units, form.columns) == (208.0, ("deg/s", "g"), ("t", "gz", "-"))
    assert dict(form.topic_selection.explicit) == {"left": "/a/b"}


def test_two_units_of_one_sensor_are_refused() -> None:
    with pytest.raises(InputError, match="--unit deg/s, rad/s: at most one for the gyro"):
        stated_input_format(_parse("--unit", "deg/s", "--unit", "rad/s"))


@pytest.mark.parametrize("text", ["left", "=/imu", "left=", "nodes=/imu"])
def test_a_topic_without_name_or_value_is_refused_with_an_example(text: str) -> None:
    with pytest.raises(InputError, match=f"--topic {text}: write NAME=/TOPIC, such as left=/imu/left_wheel"):
        stated_input_format(_parse("--topic", text))


def test_one_name_has_one_topic_and_repeating_it_is_harmless() -> None:
    assert dict(
        stated_input_format(_parse("--topic", "left=/a", "--topic", "left=/a")).topic_selection.explicit
    ) == {"left": "/a"}
    with pytest.raises(InputError, match="--topic left: is /a and /b; give one"):
        stated_input_format(_parse("--topic", "left=/a", "--topic", "left=/b"))


def test_the_vehicle_adds_its_topics_the_wheels_and_their_radius(vehicle: Vehicle) -> None:
    selection = stated_input_format(_parse("--topic", "left=/given"), vehicle).topic_selection
    assert dict(selection.explicit) == {"left": "/given"}
    assert dict(selection.configured) == {"left": "/imu/configured"}
    assert selection.wheel_radius == 0.165


@pytest.mark.parametrize("word", ["0", "-1", "much", "nan"])
def test_a_memory_limit_is_a_positive_number_of_megabytes(word: str) -> None:
    assert _parse("--max-memory", "1.5").max_memory == 1_500_000
    with pytest.raises(SystemExit):
        _parse("--max-memory", word)


def test_a_log_without_nodes_is_refused_with_its_name() -> None:
    with pytest.raises(InputError, match=r"ride\.bag: holds no samples of an IMU"):
        check_nodes(Recording({}), Path("ride.bag"))


@pytest.mark.parametrize(
    ("texts", "numbers"),
    [
        (["2048"], dict.fromkeys(IMU_CHANNELS, 2048.0)),
        (["gyro=1", "gx=2"], {"gx": 2.0, "gy": 1.0, "gz": 1.0}),
        (["accel=-0.5"], {"ax": -0.5, "ay": -0.5, "az": -0.5}),
    ],
)
def test_a_zero_is_that_of_all_channels_of_a_sensor_or_of_one(
    texts: list[str], numbers: dict[str, float]
) -> None:
    assert channel_numbers("--zero", texts) == numbers


@pytest.mark.parametrize("text", ["mx=1", "gx", "gx=inf", "0"])
def test_another_channel_or_number_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="--scale"):
        channel_numbers("--scale", [text])


def test_a_list_that_begins_with_an_ignored_column_is_a_value() -> None:
    parser = Parser()
    add_log_options(parser)
    assert parser.parse_args(["--columns", "-,gx"]).columns == "-,gx"
