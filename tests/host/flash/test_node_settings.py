"""A calibration is converted to settings that the node accepts, and replaces those of an earlier one."""

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
from hubodo.sensors.filters.rate_bias_kalman import steady_state_gain

FIRMWARE = Path(__file__).parents[3] / "firmware"


def calibration(**effects):
    entries = {
        name: CalibratedEffect({key: Quantity(value, 0.003) for key, value in values.items()})
        for name, values in effects.items()
    }
    return NodeCalibration(entries)


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
    """Load the settings.py of the firmware with the constants of its wire.py."""

    def load(name):
        spec = importlib.util.spec_from_file_location(name, FIRMWARE / f"{name}.py")
        loaded_module = importlib.util.module_from_spec(spec)
        sys.modules[name] = loaded_module
        spec.loader.exec_module(loaded_module)
        return loaded_module

    import types

    before = {name: sys.modules.get(name) for name in ("micropython", "wire", "settings")}
    sys.modules["micropython"] = types.ModuleType("micropython")
    sys.modules["micropython"].const = lambda value: value
    load("wire")
    yield load("settings")
    for name, module_before in before.items():
        if module_before is None:
            del sys.modules[name]
        else:
            sys.modules[name] = module_before


def test_settings_have_the_units_of_the_node():
    settings = node_settings(FULL, {})
    assert settings["bias_udps"] == [210_000, -1_500_000, 0]
    assert settings["warmup_udps"] == [300_000, 0, -20_000] and settings["warmup_s"] == 316
    assert settings["warmup_second"] == [0, 100_000, 0, 3816]
    assert settings["gyro_scale_ppm"] == 12_300 and settings["gyro_scale_sigma_ppm"] == 3000
    assert settings["arm_mm"] == [12, -8]


def test_the_node_loads_every_setting_unchanged(firmware, tmp_path):
    path = tmp_path / "config.json"
    config = apply_calibration_to_config({"node_id": 2, "rate_hz": 416}, FULL)
    path.write_text(json.dumps(config))
    loaded = firmware.load(str(path))
    assert {name: loaded[name] for name in config} == config
    assert set(FROM_CALIBRATION) <= set(firmware.DEFAULTS)
    defaults = (module._DEFAULT_NOISE_UDPS, module._DEFAULT_GAIN_RATE_Q20, module._DEFAULT_RATE_HZ)
    assert defaults == tuple(firmware.DEFAULTS[name] for name in ("noise_udps", "gain_rate_q20", "rate_hz"))


@pytest.mark.parametrize("sign", [1, -1])
def test_the_node_loads_the_largest_accepted_numbers_unchanged(firmware, tmp_path, sign):
    path = tmp_path / "config.json"
    max_rate = math.radians(29.9999) * sign
    extreme = calibration(
        gyro_bias={"x": max_rate, "y": max_rate, "z": max_rate},
        gyro_warmup={"x": max_rate, "time_constant": 10.0 if sign > 0 else 99_999.0},
        gyro_scale_factor={"z": 0.1999 * sign},
        lever_arm={"x": 0.9999 * sign},
        gyro_rate_random_walk={"k": 1.0},
    )
    config = apply_calibration_to_config({}, extreme)
    path.write_text(json.dumps(config))
    assert {name: value for name, value in firmware.load(str(path)).items() if name in config} == config


def test_the_bias_gain_is_that_of_the_riccati_recursion():
    """Compare with K_b of eq. 6-8 for this random walk and the rate step that gives the rate gain."""
    walk, dt, noise = 2e-5, 1 / 416, math.radians(0.075)
    bias_gain = node_settings(calibration(gyro_rate_random_walk={"k": walk}), {})["gain_bias_q30"] / 2**30
    rate_gain = 314573 / 2**20
    rate_step = math.sqrt(noise**2 * rate_gain**2 / (1 - rate_gain))
    expected_rate_gain, expected_bias_gain = steady_state_gain(
        rate_step, walk * math.sqrt(dt), noise, dt
    ).per_sample(dt)
    assert expected_rate_gain == pytest.approx(rate_gain, rel=1e-4)
    assert bias_gain == pytest.approx(expected_bias_gain, rel=1e-3)


def test_settings_of_an_earlier_calibration_are_removed():
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
def test_numbers_beyond_the_range_of_the_settings_are_refused_in_one_line(effect, values):
    with pytest.raises(CalibrationError, match=effect) as caught:
        node_settings(calibration(**{effect: values}), {})
    assert "\n" not in str(caught.value)
