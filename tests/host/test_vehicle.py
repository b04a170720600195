"""Vehicle files: geometry and mounting, and errors that name file, table and key."""

import re
import tomllib

import pytest

from hubodo.errors import ConfigError
from hubodo.vehicle import NodeMount, facing_sign, parse_vehicle, side_sign

SIZES = "[vehicle]\nwheel_radius = 0.2\ntrack_width = 0.5\n"


def vehicle(text):
    return parse_vehicle(tomllib.loads(text), "v.toml")


def test_a_node_inherits_ranges_that_it_does_not_have_itself():
    text = (
        f'{SIZES}[imu]\ngyro_range = 17.0\naccel_range = 80.0\n[nodes.a]\nside = "left"\nfacing = "right"\n'
    )
    parsed = vehicle(f"{text}gyro_range = 35.0\n")
    assert parsed.nodes["a"] == NodeMount("left", "right", 35.0, 80.0)
    assert parsed.node_on_wheel("left") == "a" and parsed.node_on_wheel("right") is None


def test_a_radius_of_unknown_origin_is_a_nominal_one():
    assert vehicle(SIZES).radius_from == "nominal"
    assert vehicle(f'{SIZES}radius_from = "rolled"\n').radius_from == "rolled"


def test_left_is_positive_in_side_and_facing():
    assert side_sign("left") == facing_sign("left") == 1.0
    assert side_sign("right") == facing_sign("right") == -1.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"\[vehicle\] is missing"),
        (SIZES.replace("0.5", "0.0"), "track_width = 0.0: must be a finite number above 0"),
        (f'{SIZES}[nodes.a]\nside = "left"\n', r"\[nodes.a\]: facing is missing"),
        (f"{SIZES}antenna = [1.0]\n", r"antenna: give \[forward, left\] in metres"),
        (f"{SIZES}latitude_deg = 91.0\n", "degrees north, from -90 to 90"),
        (f'{SIZES}radius_from = "guess"\n', 'radius_from = .guess.: .* "tape", "rolled", "nominal"'),
        (f"{SIZES}wheel_diameter = 1.0\n", "write half of it as wheel_radius"),
        (f"{SIZES}wheel_radios = 1.0\n", "did you mean 'wheel_radius'"),
    ],
)
def test_an_invalid_value_is_named_with_file_and_key(text, message):
    with pytest.raises(ConfigError, match=f"v.toml: .*{message}"):
        vehicle(text)


@pytest.mark.parametrize(
    ("sizes", "hint"),
    [
        ("wheel_radius = 16.5\ntrack_width = 0.5", "16.5 cm are 0.165"),
        ("wheel_radius = 165\ntrack_width = 0.5", "165 mm are 0.165"),
        ("wheel_radius = 0.16\ntrack_width = 55", "55 cm are 0.55"),
        ("wheel_radius = 0.16\ntrack_width = 0.03", "a track of 0.03 m"),
        ("wheel_radius = 1.2\ntrack_width = 2.5", "unusual_size = true"),
    ],
)
def test_a_size_in_another_unit_is_asked_back(sizes: str, hint: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(hint)):
        parse_vehicle(tomllib.loads(f"[vehicle]\n{sizes}"), "v.toml")
    assert parse_vehicle(tomllib.loads(f"[vehicle]\n{sizes}\nunusual_size = true"), "v.toml").track_width > 0
