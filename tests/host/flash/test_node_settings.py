"""A calibration becomes settings that the node takes, and nothing of another one stays."""

import importlib.util
import json
import math
import sys
from pathlib import Path

import pytest

from hubodo.calibration.file import CalibratedEffect, NodeCalibration, Quantity
from hubodo.errors import CalibrationError
from hubodo.flash import node_settings as module
from hubodo.flash.node_settings import FROM_CALIBRATION, apply_calibration_to_config, node_settings
from hubodo.sensors.warmup.rate_bias_kalman import steady_state_gain

FIRMWARE = Path(__file__).parents[3] / "firmware"


def calibration(**effects):
    made = {
        name: CalibratedEffect({key: Quantity(value, 0.003) for key, value in values.items()})
        for name, values in effects.items()
    }
    return NodeCalibration(made)


FULL = calibration(
    gyro_bias={"x": math.radians(0.21), "y": -math.radians(1.5), "z": 0.0},
    gyro_warmup={
        "x": math.radians(0.3),
        "z": -math.radians(0.02),
        "time_constant": 316.4,
        "y_second": math.radians(0.1),
        "time_constant_second": 3816.4,
    },
    gyro_scale_factor={"x": 0.5, "z": 0.0123},
    lever_arm={"x": 0.0124, "y": -0.0076, "z": 1.0},
    gyro_rate_random_walk={"k": 2e-5},
    accel_bias={"x": 0.1},
)


@pytest.fixture(scope="module")
def firmware():
    """The node's own settings.py, with the constants of its wire.py."""

    def load(name):
        spec = importlib.util.spec_from_file_location(name, FIRMWARE / f"{name}.py")
        made = importlib.util.module_from_spec(spec)
        sys.modules[name] = made
        spec.loader.exec_module(made)
        return made

    import types

    before = {name: sys.modules.get(name) for name in ("micropython", "wire", "settings")}
    sys.modules["micropython"] = types.ModuleType("micropython")
    sys.modules["micropython"].const = lambda value: value
    load("wire")
    yield load("settings")
    for name, old in before.items():
        if old is None:
            del sys.modules[name]
        else:
            sys.modules[name] = old


def test_units_are_those_of_the_node():
    made = node_settings(FULL, {})
    assert made["bias_udps"] == [210_000, -1_500_000, 0]
    assert made["warmup_udps"] == [300_000, 0, -20_000] and made["warmup_s"] == 316
    assert made["warmup_second"] == [0, 100_000, 0, 3816]
    assert made["gyro_scale_ppm"] == 12_300 and made["gyro_scale_sigma_ppm"] == 3000
    assert made["arm_mm"] == [12, -8]


def test_the_node_takes_every_setting_as_it_is(firmware, tmp_path):
    path = tmp_path / "config.json"
    made = apply_calibration_to_config({"node_id": 2, "rate_hz": 416}, FULL)
    path.write_text(json.dumps(made))
    loaded = firmware.load(str(path))
    assert {name: loaded[name] for name in made} == made
    assert set(FROM_CALIBRATION) <= set(firmware.DEFAULTS)
    defaults = (module._DEFAULT_NOISE_UDPS, module._DEFAULT_GAIN_RATE_Q20, module._DEFAULT_RATE_HZ)
    assert defaults == tuple(firmware.DEFAULTS[name] for name in ("noise_udps", "gain_rate_q20", "rate_hz"))


@pytest.mark.parametrize("sign", [1, -1])
def test_the_largest_numbers_that_are_let_through_are_taken_by_the_node(firmware, tmp_path, sign):
    path = tmp_path / "config.json"
    most = math.radians(29.9999) * sign
    edge = calibration(
        gyro_bias={"x": most, "y": most, "z": most},
        gyro_warmup={"x": most, "time_constant": 10.0 if sign > 0 else 99_999.0},
        gyro_scale_factor={"z": 0.1999 * sign},
        lever_arm={"x": 0.9999 * sign},
        gyro_rate_random_walk={"k": 1.0},
    )
    made = apply_calibration_to_config({}, edge)
    path.write_text(json.dumps(made))
    assert {name: value for name, value in firmware.load(str(path)).items() if name in made} == made


def test_the_gain_of_the_bias_is_that_of_the_riccati_recursion():
    """Eq. 6-8 with the rate step that settles at the node's gain; their K_b for this random walk."""
    walk, dt, noise = 2e-5, 1 / 416, math.radians(0.075)
    found = node_settings(calibration(gyro_rate_random_walk={"k": walk}), {})["gain_bias_q30"] / 2**30
    gain = 314573 / 2**20
    rate_step = math.sqrt(noise**2 * gain**2 / (1 - gain))
    on_rate, on_bias = steady_state_gain(rate_step, walk * math.sqrt(dt), noise, dt).per_sample(dt)
    assert on_rate == pytest.approx(gain, rel=1e-4)
    assert found == pytest.approx(on_bias, rel=1e-3)


def test_what_a_calibration_does_not_hold_does_not_stay_from_the_one_before():
    config = apply_calibration_to_config({"node_id": 1, "watchdog": False}, FULL)
    assert set(FROM_CALIBRATION) <= set(config)
    again = apply_calibration_to_config(config, calibration(gyro_bias={"x": 0.001}))
    assert again == {"node_id": 1, "watchdog": False, "bias_udps": [57296, 0, 0]}


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        ("gyro_bias", {"x": 1.0}),
        ("gyro_warmup", {"x": 0.001, "time_constant": 3.0}),
        ("gyro_warmup", {"x": 0.001}),
        ("gyro_warmup", {"x": 0.001, "time_constant": 60.0, "x_second": 0.001}),
        ("gyro_scale_factor", {"z": 0.3}),
        ("lever_arm", {"y": -2.0}),
    ],
)
def test_numbers_that_no_node_takes_are_refused_in_one_line(effect, values):
    with pytest.raises(CalibrationError, match=effect) as caught:
        node_settings(calibration(**{effect: values}), {})
    assert "\n" not in str(caught.value)
