"""Configuration files: every key is checked, and an error names file, key and the most similar known key."""

import pytest

from hubodo.errors import ConfigError
from hubodo.ingest.live.record_config import RecordConfig, load_record_config
from hubodo.vehicle import Vehicle, load_vehicle
from in_process import hubodo

VEHICLE = """
[vehicle]
wheel_radius = 0.31
track_width = 0.92
[imu]
gyro_noise = 0.004
[nodes.left]
side = "left"
facing = "left"
[nodes.right]
side = "right"
facing = "right"
[nodes.right.effects.wheel_radius]
error = 0.001
[nodes.frame]
[inputs]
speed = "reference.speed"
[effects.gyro_bias]
z = 0.002
"""


def write_file(tmp_path, text):
    path = tmp_path / "some.toml"
    path.write_text(text)
    return path


def test_a_model_file_is_also_a_vehicle_file(tmp_path):
    vehicle = load_vehicle(write_file(tmp_path, VEHICLE))
    assert isinstance(vehicle, Vehicle)
    assert (vehicle.wheel_radius, vehicle.track_width) == (0.31, 0.92)
    assert vehicle.node_on_wheel("left") == "left"
    assert vehicle.nodes["right"].facing == "right"
    assert vehicle.nodes["frame"].side is None


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "wheel_radius = 0.31",
            "weel_radius = 0.31",
            "unknown key 'weel_radius', did you mean 'wheel_radius'",
        ),
        ("wheel_radius = 0.31\n", "", "wheel_radius is missing"),
        ("wheel_radius = 0.31", "wheel_radius = -1", "above 0"),
        ("wheel_radius = 0.31", "wheel_radius = nan", "finite number"),
        ("wheel_radius = 0.31", "wheel_radius = '0.31'", "must be a number"),
        ("wheel_radius = 0.31", "wheel_radius = true", "must be a number"),
        ("[vehicle]", "[vehicel]", "did you mean 'vehicle'"),
        ('facing = "right"', 'facing = "rihgt"', "did you mean 'right'"),
        ('facing = "right"', "", "facing is missing"),
        ("[nodes.frame]", "[nodes.frame]\nsied = 'left'", "did you mean 'side'"),
        ("[vehicle]", "[vehicle", "not TOML"),
        ("[nodes.frame]", "[nodes]\nframe = 3", "must be a table"),
    ],
)
def test_each_mistake_in_a_vehicle_file_is_named(tmp_path, old, new, message):
    path = write_file(tmp_path, VEHICLE.replace(old, new, 1))
    with pytest.raises(ConfigError) as caught:
        load_vehicle(path)
    assert message in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_reported(tmp_path):
    with pytest.raises(ConfigError, match="no such file"):
        load_vehicle(tmp_path / "nope.toml")


def test_an_empty_recorder_file_means_all_defaults(tmp_path):
    assert load_record_config(write_file(tmp_path, "")) == RecordConfig()


def test_a_recorder_file_is_read_with_its_types(tmp_path):
    text = '[record]\nports = ["left=/dev/ttyACM0"]\nduration = 60\nwait = true\ncompression = "lz4"\n'
    config = load_record_config(write_file(tmp_path, text))
    assert config.ports == ("left=/dev/ttyACM0",)
    assert config.duration == 60.0
    assert config.wait is True
    assert config.compression == "lz4"


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("bauds = 9600", "did you mean 'baud'"),
        ("baud = 0", "above 0"),
        ('baud = "9600"', "a whole number"),
        ("ports = 3", "list of texts"),
        ("ports = [3]", "list of texts"),
        ('compression = "zst"', "did you mean 'zstd'"),
        ("wait = 1", "true or false"),
        ("duration = -5", "above 0"),
        ("odometry_rate_hz = 0", "above 0"),
    ],
)
def test_each_mistake_in_a_recorder_file_is_named(tmp_path, line, message):
    with pytest.raises(ConfigError, match=message):
        load_record_config(write_file(tmp_path, f"[record]\n{line}\n"))


def test_the_example_is_written_to_a_file_that_the_check_accepts(tmp_path):
    path = tmp_path / "hubodo.toml"
    assert hubodo("config", "example", "-o", path).code == 0
    assert path.read_text() == hubodo("config", "example").out
    assert hubodo("config", "check", path).out == f"{path}: valid\n"
    again = hubodo("config", "example", "-o", path)
    assert again.code == 2 and "exists already" in again.err


def test_a_vehicle_file_is_named_as_one_instead_of_its_first_key(tmp_path):
    done = hubodo("config", "check", write_file(tmp_path, VEHICLE))
    assert done.code == 2 and "is a vehicle or model file" in done.err
