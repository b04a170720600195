"""The model file: written values are read back; each mistake is named with its place and the nearest word."""

import math
from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hubodo.effects import EFFECTS, Noise
from hubodo.effects.accel import AccelBias
from hubodo.effects.gyro import GyroBias, GyroSaturation
from hubodo.effects.vehicle import TrackWidth
from hubodo.effects.wheel import WheelRadius
from hubodo.errors import ConfigError
from hubodo.model.model_file import InputSources, Model, ScopedEffect, read_model, split_input
from hubodo.model.model_text import model_toml, write_model
from hubodo.vehicle import RADIUS_SOURCES, NodeMount, Vehicle, load_vehicle

TEXT = """
[vehicle]
wheel_radius = 0.31
track_width = 0.92
[imu]
gyro_noise = 0.004
accel_noise = 0.05
[nodes.left]
side = "left"
facing = "left"
[nodes.right]
side = "right"
facing = "left"
[nodes.box]
[inputs]
speed = "reference.speed"
yaw_rate = "reference.yaw_rate"
speed_noise = 0.0005
yaw_rate_noise = 0.0002
clock_sigma = 0.002
[effects.gyro_bias]
z = 0.002
[effects.wheel_radius]
error = 0.01
[nodes.left.effects.wheel_radius]
error = 0.001
"""


def written(folder, text):
    path = folder / "model.toml"
    path.write_text(text, "utf-8")
    return path


def test_a_model_file_is_read_with_units_as_they_stand(tmp_path):
    model = read_model(written(tmp_path, TEXT))
    assert model.noise == Noise(0.004, 0.05)
    assert model.inputs == InputSources("reference.speed", "reference.yaw_rate", 0.0005, 0.0002, 0.002)
    assert model.vehicle == load_vehicle(tmp_path / "model.toml")
    assert model.effects == (
        ScopedEffect(WheelRadius(0.01)),
        ScopedEffect(GyroBias(z=0.002)),
        ScopedEffect(WheelRadius(0.001), "left"),
    )


def test_a_nodes_own_effect_replaces_that_of_all_and_nodes_off_the_wheels_have_no_effects_of_wheels(tmp_path):
    model = read_model(written(tmp_path, TEXT))
    assert model.effects_of("left") == (WheelRadius(0.001), GyroBias(z=0.002))
    assert model.effects_of("right") == (WheelRadius(0.01), GyroBias(z=0.002))
    assert model.effects_of("box") == (GyroBias(z=0.002),)


def test_inputs_are_the_exact_reference_where_the_file_says_nothing(tmp_path):
    model = read_model(written(tmp_path, TEXT.split("[inputs]")[0]))
    assert model.inputs == InputSources("reference.speed", "reference.yaw_rate", 0.0, 0.0)


@pytest.mark.parametrize("name", ["nodes", "nodes.left.gz", "left.gz", "nodes.box.gz", "frame.gz", 0.0, 2])
def test_inputs_are_channels_or_constants(tmp_path, name):
    text = TEXT.replace('"reference.yaw_rate"', f'"{name}"' if isinstance(name, str) else str(name))
    assert read_model(written(tmp_path, text)).inputs.yaw_rate == name


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("reference.speed", ("reference", "speed")),
        ("nodes.left.gz", ("left", "gz")),
        ("frame.gz", ("frame", "gz")),
        ("nodes", ("nodes", "")),
    ],
)
def test_the_name_of_an_input_has_a_source_and_a_channel(name, parts):
    assert split_input(name) == parts


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (
            "[effects.gyro_bias]",
            "[effects.gyro_bais]",
            "[effects.gyro_bais]: no such effect, did you mean 'gyr",
        ),
        ("z = 0.002", "q = 0.002", "[effects.gyro_bias]: unknown key 'q'"),
        ("error = 0.01\n", "eror = 0.01\n", "unknown key 'eror', did you mean 'error'"),
        ("z = 0.002", "z = nan", "[effects.gyro_bias] z = nan: must be a finite number"),
        ("z = 0.002", "z = inf", "finite"),
        ("z = 0.002", "z = '1'", "must be a number"),
        ("z = 0.002", "", "[effects.gyro_bias]: empty"),
        ("gyro_noise = 0.004\n", "", "gyro_noise is missing"),
        ("accel_noise = 0.05", "acel_noise = 0.05", "did you mean 'accel_noise'"),
        ("gyro_noise = 0.004", "gyro_noise = 0", "above 0"),
        ("gyro_noise = 0.004", "gyro_noise = nan", "finite number"),
        ("[imu]", "[imv]", "did you mean 'imu'"),
        ("[imu]\ngyro_noise = 0.004\naccel_noise = 0.05", "", "[imu] is missing"),
        ("speed_noise", "sped_noise", "did you mean 'speed_noise'"),
        ("speed_noise = 0.0005", "speed_noise = -1", "0 or more"),
        ("clock_sigma = 0.002", "clock_sigma = -1", "0 or more"),
        ("clock_sigma", "clok_sigma", "did you mean 'clock_sigma'"),
        ('"reference.speed"', '"refrence.speed"', "did you mean 'reference.speed'"),
        ('"reference.speed"', '"reference.sped"', "did you mean 'reference.speed'"),
        ('"reference.speed"', '"nodes.lef.gz"', "did you mean 'nodes.left.gz'"),
        ('"reference.speed"', '"nodes.left.ax"', "no such input"),
        ('"reference.speed"', "true", "must be a number"),
        ('"reference.speed"', "inf", "finite"),
        (
            "[nodes.left.effects.wheel_radius]\nerror",
            "[nodes.left.effects.track_width]\nerror",
            "of the vehicle",
        ),
        ("[nodes.left.effects.wheel_radius]", "[nodes.box.effects.wheel_radius]", "the node is on none"),
        ("z = 0.002", "z = 0.002\n[effects.gyro_lag]\ntime_constant = -0.1", "above 0"),
        ("z = 0.002", "z = 0.002\n[effects.gyro_warmup]\nz = 1\ntime_constant = 0", "above 0"),
        ("z = 0.002", "z = 0.002\n[effects.sample_repeat]\nprobability = 1.5", "within ±1"),
        ("error = 0.001", "error = -1.0", "within ±0.9"),
    ],
)
def test_each_mistake_in_a_model_is_named_with_its_place(tmp_path, old, new, says):
    assert old in TEXT
    path = written(tmp_path, TEXT.replace(old, new, 1))
    with pytest.raises(ConfigError) as caught:
        read_model(path)
    assert says in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def numbers_for(kind):
    """A strategy of effects of one kind with values that a file may hold."""
    values = {}
    for name in kind.parameters():
        about = kind.__dataclass_fields__[name].metadata
        high = min(about["max_magnitude"], 1e6)
        low = 1e-12 if about["positive"] else -high
        values[name] = st.floats(low, high)
    return st.builds(kind, **values)


# Hypothesis takes seconds to list the characters of its default, a codec.
CHARACTERS = st.characters(exclude_categories=["Cs"])


@st.composite
def models(draw):
    names = draw(st.lists(st.text(CHARACTERS, min_size=1, max_size=6), max_size=3, unique=True))
    sides = st.sampled_from(["left", "right"])
    mounts = st.one_of(st.just(NodeMount()), st.builds(NodeMount, sides, sides))
    nodes = {name: draw(mounts) for name in names}
    positive = st.floats(1e-6, 1e6)
    effects = []
    for kind in EFFECTS:
        places = [None]
        if kind.level != "vehicle":
            places += [n for n, m in nodes.items() if m.side or kind.level != "wheel"]
        for place in draw(st.lists(st.sampled_from(places), max_size=1)):
            effects.append(ScopedEffect(draw(numbers_for(kind)), place))
    speed = st.one_of(st.floats(-10, 10), st.sampled_from(["nodes", "reference.speed"]))
    noise = st.floats(0, 1)
    inputs = InputSources(draw(speed), draw(speed), draw(noise), draw(noise))
    antenna = draw(st.one_of(st.none(), st.tuples(st.floats(-9, 9), st.floats(-9, 9))))
    source = draw(st.sampled_from(RADIUS_SOURCES))
    vehicle = Vehicle(draw(positive), draw(positive), nodes, antenna, radius_from=source)
    return Model(
        vehicle, Noise(draw(positive), draw(positive)), inputs, tuple(draw(st.permutations(effects)))
    )


def _with(kind):
    values = {name: kind.scale(name) / 3 for name in kind.parameters()}
    return Model(Vehicle(0.3, 0.9), Noise(0.01, 0.1), effects=(ScopedEffect(kind(**values)),))


@settings(max_examples=25)
@given(model=models(), words=st.text(CHARACTERS, max_size=20))
@example(model=_with(EFFECTS[0]), words='two\nlines\r# "x" = \\ \x7f\x85\u2028')
def test_a_written_model_is_read_back_equal(tmp_path_factory, model, words):
    path = tmp_path_factory.getbasetemp() / "made.toml"
    comments = {(item.effect.name, item.node): words for item in model.effects}
    write_model(model, path, comments)
    assert read_model(path) == model


@pytest.mark.parametrize("kind", EFFECTS)
def test_each_effect_reads_back_equal(tmp_path, kind):
    model = _with(kind)
    write_model(model, tmp_path / "m.toml")
    assert read_model(tmp_path / "m.toml") == model


def test_units_and_comments_are_beside_their_parameters():
    vehicle = Vehicle(0.3, 0.9, {"left": NodeMount("left", "left")})
    model = Model(
        vehicle,
        Noise(0.01, 0.1),
        effects=(ScopedEffect(WheelRadius(0.02), "left"), ScopedEffect(AccelBias(x=1.0))),
    )
    lines = model_toml(model, {("wheel_radius", "left"): "found first"}).splitlines()
    at = lines.index("[nodes.left.effects.wheel_radius]")
    assert lines[at - 1] == "# found first"
    assert lines[at + 1].split("#")[1].strip() == "1"
    assert any(line.startswith("x = 1.0") and line.endswith("# m/s²") for line in lines)


def test_a_value_that_could_not_be_read_is_not_written(tmp_path):
    model = Model(Vehicle(0.3, 0.9), Noise(0.01, 0.1), effects=(ScopedEffect(GyroSaturation()),))
    with pytest.raises(ValueError, match="gyro_saturation limit = inf"):
        write_model(model, tmp_path / "m.toml")
    assert not Path(tmp_path / "m.toml").exists()


def test_a_model_cannot_hold_an_effect_where_it_does_not_belong():
    vehicle = Vehicle(0.3, 0.9, {"left": NodeMount("left", "left")})
    for effects in (
        (ScopedEffect(TrackWidth(0.1), "left"),),
        (ScopedEffect(WheelRadius(0.1), "rigth"),),
        (ScopedEffect(WheelRadius(0.1)), ScopedEffect(WheelRadius(0.2))),
    ):
        with pytest.raises(ValueError, match=r"wheel_radius|track_width"):
            Model(vehicle, Noise(1.0, 1.0), effects=effects)


def test_an_added_effect_replaces_its_like_in_the_same_place_only():
    vehicle = Vehicle(0.3, 0.9, {"left": NodeMount("left", "left")})
    model = Model(
        vehicle,
        Noise(1.0, 1.0),
        effects=(ScopedEffect(WheelRadius(0.1)), ScopedEffect(WheelRadius(0.2), "left")),
    )
    assert model.with_effects(ScopedEffect(WheelRadius(0.3), "left")).effects == (
        ScopedEffect(WheelRadius(0.1)),
        ScopedEffect(WheelRadius(0.3), "left"),
    )
    assert math.isclose(model.effects_of("left")[0].error, 0.2)
