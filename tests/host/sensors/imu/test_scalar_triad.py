"""Application of a calibration: one formula in both directions, in the signs of the model; and its file."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from generators.poses import Errors
from hubodo.calibration.file import (
    CalibratedEffect,
    Calibration,
    Quantity,
    format_calibration,
    read_calibration,
    write_calibration,
)
from hubodo.calibration.triad import Triad, effects_from_triad, triad_from_effects
from hubodo.errors import ConfigError

small = st.floats(-0.2, 0.2)
three = st.tuples(small, small, small)
angles = st.fixed_dictionaries({name: st.floats(-0.1, 0.1) for name in ("xz", "xy", "yz", "yx", "zy", "zx")})


def triad_effects(b, e, d):
    """Return the triad of a calibration with these biases, scale errors and angles."""
    parts = {"gyro_bias": b, "gyro_scale_factor": e}
    result = {
        name: CalibratedEffect({a: Quantity(v, 0.0) for a, v in zip("xyz", values, strict=True)})
        for name, values in parts.items()
    }
    angles = CalibratedEffect({name: Quantity(angle, 0.0) for name, angle in d.items()})
    return triad_from_effects({**result, "gyro_nonorthogonality": angles}, "gyro")


@given(three, three, angles, st.lists(three, min_size=1, max_size=5))
def test_apply_undoes_the_forward_model_written_out_by_hand(b, e, d, true):
    true = np.array(true)
    triad = triad_effects(b, e, d)
    raw = Errors(b, e, d).measure(true)
    assert np.allclose(triad.correct(raw), true, atol=1e-12)
    assert np.allclose(triad.correct(raw[0]), true[0], atol=1e-12)


def test_the_bias_is_subtracted_before_the_matrix_is_inverted():
    triad = Triad(np.array([1.0, 0, 0]), np.diag([2.0, 1, 1]))
    assert triad.correct(np.array([5.0, 0, 0]))[0] == 2.0
    assert triad.correct(np.array([5.5, 0, 0]), np.array([0.5, 0, 0]))[0] == 2.0


@given(three, three, angles)
def test_a_triad_survives_the_calibration_file(b, e, d):
    triad = triad_effects(b, e, d)
    built = effects_from_triad(triad, np.full(12, 1e-3), "gyro")
    back = triad_from_effects({name: CalibratedEffect(p) for name, p in built.items()}, "gyro")
    assert np.allclose(back.matrix, triad.matrix, atol=1e-15) and np.allclose(back.bias, triad.bias, atol=0)


def test_the_file_keeps_every_digit_the_provenance_and_what_was_in_it_before(tmp_path):
    path = tmp_path / "c.toml"
    first = CalibratedEffect(
        {"x": Quantity(1 / 3, 1e-7)}, 'by "hand"\n', "ab" * 32, "2026-01-02", (20.5, 31.0)
    )
    write_calibration(Calibration().with_node("left wheel", {"gyro_bias": first}, "e66"), path)
    again = read_calibration(path).with_node(
        "left wheel", {"lever_arm": CalibratedEffect({"y": Quantity(0.01, 0.001)})}
    )
    write_calibration(
        again.with_vehicle({"track_width": CalibratedEffect({"error": Quantity(0.01, 0.002)})}), path
    )
    read = read_calibration(path)
    assert read.nodes["left wheel"].effects["gyro_bias"] == first
    assert read.nodes["left wheel"].serial == "e66"
    assert read.vehicle["track_width"].value("error") == 0.01
    assert format_calibration(read) == path.read_text()


@pytest.mark.parametrize(
    "text, words",
    [
        ("[nodes.a.effects.gyro_bais]\nx = {value=1, sigma=1}", "did you mean 'gyro_bias'"),
        ("[nodes.a.effects.gyro_bias]\nw = {value=1, sigma=1}", "unknown key 'w'"),
        ("[nodes.a.effects.gyro_bias]\nx = {value=nan, sigma=1}", "finite"),
        ("[nodes.a.effects.gyro_bias]\nx = {value=1}", "sigma is missing"),
        ("[nodes.a.effects.gyro_bias]\nx = {value=1, sigma=-1}", "negative"),
        ("[nodes.a.effects.gyro_bias]\nx = 3", "must be a table"),
        ("[nodes.a.effects.wheel_radius]\nerror = {value=2, sigma=1}", "must lie within ±0.9"),
        ("[nodes.a.effects.gyro_rate_random_walk]\nk = {value=-1, sigma=1}", "must be above 0"),
        (
            "[nodes.a.effects.track_width]\nerror = {value=0, sigma=1}",
            "move it to [vehicle.effects.track_width]",
        ),
        ("[nodes.a.effects.gyro_bias]\nmethod = 3", "must be a text"),
        ("[vehicle]\nwheel_radius = 0.3", "describes a vehicle, and a calibration is due"),
        ("[node.a]", "did you mean 'nodes'"),
        ("nodes = [", "not TOML"),
    ],
)
def test_a_wrong_file_is_refused_with_the_place_and_a_near_match(tmp_path, text, words):
    path = tmp_path / "c.toml"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        read_calibration(path)
    assert words in str(caught.value) and str(path) in str(caught.value)


def test_any_effect_of_the_model_may_be_calibrated(tmp_path):
    path = tmp_path / "c.toml"
    text = "[nodes.a.effects.wheel_camber]\nangle = {value=0.02, sigma=0.001}\n"
    path.write_text(text + "[vehicle.effects.road_grade]\nangle = {value=0.01, sigma=0.001}\n")
    read = read_calibration(path)
    assert read.nodes["a"].effects["wheel_camber"].parameters == {"angle": Quantity(0.02, 0.001)}
    assert read.vehicle["road_grade"].value("angle") == 0.01
