"""Bias against temperature in `warmup`: polynomial, hysteresis, calibration file and figure."""

import numpy as np
import pytest

from generators.warm_ups import NOISE, heat_cycle
from hubodo.effects.warmup import WarmupModel
from hubodo.sensors.heading.prior import vertical_axis_warmup
from hubodo.sensors.warmup.characterise import characterise_warmup
from hubodo.sensors.warmup.hysteresis import find_hysteresis
from hubodo.sensors.warmup.page import warmup_sections

DEG = np.pi / 180.0


@pytest.fixture(scope="module")
def looped():
    """Return the true coefficients and the result of a quadratic with a loop of 0.05 deg/s."""
    rng = np.random.default_rng(4)
    t, bias, temperature, coefficients = heat_cycle(3600, 2, rng, hysteresis=0.05)
    output = (bias + rng.normal(0.0, NOISE, len(t))) * DEG
    return coefficients, characterise_warmup(t, output, "gz", temperature=temperature, node="imu")


def test_a_quadratic_with_a_loop_is_accepted_and_its_hysteresis_named(looped):
    coefficients, result = looped
    assert result.accepted is not None and result.accepted.fit.kind == "quadratic temperature"
    for name, true in zip(("temperature_coefficient", "temperature_quadratic"), coefficients, strict=True):
        assert abs(result.values[name] - true * DEG) < 4.0 * result.sigma[name]
    assert result.hysteresis.difference == pytest.approx(0.05 * DEG, abs=4.0 * result.hysteresis.sigma)
    assert result.sigma["c2"] > 0.02 * DEG
    assert any("hysteresis" in line for line in result.remarks)
    assert result.as_json()["hysteresis"]["difference"] == result.hysteresis.difference


def test_the_polynomial_reaches_the_calibration_file_and_the_heading(looped):
    _, result = looped
    effects = result.calibrated_effects()
    polynomial = effects["gyro_temperature"]
    assert set(polynomial.parameters) == {"z", "z_quadratic"}
    model, _ = vertical_axis_warmup(effects, "z", 1.0, thermometer=True)
    warm = np.array([10.0, 25.0, 40.0])
    expected = result.accepted.fit.model.bias(np.zeros(3), warm) - result.values["c2"]
    np.testing.assert_allclose(model.bias(np.zeros(3), warm), expected, rtol=1e-12)


def test_the_page_shows_the_rate_against_the_temperature(looped):
    section = next(it for it in warmup_sections(looped[1]) if it.title == "Rate against temperature")
    assert section.figures


def test_one_direction_and_white_noise_show_no_hysteresis():
    t = np.arange(2000.0)
    noise = np.random.default_rng(1).normal(0.0, 1e-3, len(t))
    up_and_down = 25.0 + 10.0 * np.sin(2.0 * np.pi * t / 2000.0)
    assert find_hysteresis(t, up_and_down, noise, 1) is None
    loop = noise + 5e-4 * np.sign(np.gradient(up_and_down))
    assert find_hysteresis(t, up_and_down, loop, 1).difference == pytest.approx(1e-3, rel=0.2)
    assert find_hysteresis(t, 20.0 + 0.01 * t, loop, 1) is None


def test_a_model_with_powers_of_the_temperature_needs_it():
    with pytest.raises(ValueError, match="needs the temperature"):
        WarmupModel(0.0, temperature_cubic=1e-6).bias(np.zeros(2))


def test_flicker_of_the_bias_is_in_the_sigma_of_the_coefficients():
    """A slow cycle of the temperature resembles flicker, which white noise of the residual does not show."""
    rng = np.random.default_rng(200)
    t, bias, temperature, true = heat_cycle(3600, 1, rng, added="flicker")
    output = (bias + rng.normal(0.0, NOISE, len(t))) * DEG
    result = characterise_warmup(t, output, "gz", temperature=temperature)
    name = "temperature_coefficient"
    assert abs(result.values[name] - true[0] * DEG) < 3.0 * result.sigma[name]
    assert result.sigma[name] > 1.2 * result.accepted.fit.sigma[name]
