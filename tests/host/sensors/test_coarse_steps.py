"""Gyros with output steps larger than their noise: sigma includes the rounding, or they are refused."""

import numpy as np
import pytest

from generators.odd_records import disturb
from generators.steady_turns import steady_turns
from hubodo.errors import InputError
from hubodo.recording import Recording, Table
from hubodo.sensors.allan.characterise import characterise_noise
from hubodo.sensors.heading.estimate import HeadingOptions, heading_from_recording
from hubodo.sensors.imu.quantisation import rounding_sigma
from hubodo.sensors.warmup.characterise import characterise_warmup

DEG = np.pi / 180


@pytest.mark.parametrize(("noise", "levels"), [(0.15, "few"), (0.3, "few"), (2.0, "many")])
def test_the_error_of_a_mean_is_within_that_of_the_rounding(noise, levels):
    """Two hundred biases, seed 5: means of 2000 samples rounded to 1e-3 are off by at most the sigma stated.

    They are off by at least half of it: a bias amid two levels scatters less, as if there were less noise.
    """
    rng = np.random.default_rng(5)
    step, errors, stated = 1e-3, [], []
    for bias in rng.uniform(0.0, 1.0, 200) * step:
        values = step * np.rint((bias + noise * step * rng.standard_normal(2000)) / step)
        if len(np.unique(values)) > 1:
            assert rounding_sigma(values)[1] == pytest.approx(step)
        assert (len(np.unique(values)) > 8) == (levels == "many")
        errors.append(values.mean() - bias)
        stated.append(np.hypot(rounding_sigma(values, step)[0], noise * step / np.sqrt(2000)))
    assert 0.5 < np.sqrt(np.mean(np.square(errors)) / np.mean(np.square(stated))) < 1.1


def test_values_that_are_not_rounded_have_no_step():
    assert rounding_sigma(np.random.default_rng(2).standard_normal(4000)) == (0.0, 0.0)


@pytest.mark.parametrize(("change", "step"), [("LSB of 4 sigma", "0.8"), ("LSB of 15 sigma", "3")])
def test_the_sigma_of_a_heading_includes_the_rounding(change, step):
    """Seeds 0 to 3: an answer is within 3 sigma and names the steps; steps of 3 deg/s are mostly refused."""
    answers = 0
    for seed in range(4):
        rng = np.random.default_rng([seed, 5])
        t, gyro, accel, true = steady_turns([seed, 4], standstills=(0, 9), scale_sigma=0.01)
        t, gyro, accel = disturb(change, t, gyro, accel, rng, 0.0)
        columns = dict(zip(("t", "gx", "gy", "gz", "ax", "ay", "az"), (t, *gyro.T, *accel.T), strict=True))
        recording = Recording({"imu": Table(columns)})
        try:
            result = heading_from_recording(recording, "imu", HeadingOptions(), log="log")
        except InputError:
            continue
        answers += 1
        assert abs(result.track.heading[-1] - true[-1]) < 3 * result.track.sigma[-1]
        assert any(f"steps of {step}" in note and "does not average out" in note for note in result.notes)
    assert answers > 1 or step == "3"


def test_the_sigma_of_a_warm_up_includes_the_rounding():
    rng = np.random.default_rng(1)
    t = np.arange(3600.0)
    bias = 0.1 * DEG * -np.expm1(-t / 700.0)
    step = 0.4 * DEG
    values = step * np.rint((bias + 0.1 * DEG * rng.standard_normal(len(t))) / step)
    result = characterise_warmup(t, values, "gz")
    assert any("steps of 0.4 deg/s" in note for note in result.notes)
    mean, sigma = result.forecast.predict(np.array([3600.0, 7200.0]))
    assert sigma[0] > 0.02 * DEG
    assert (np.abs(mean - 0.1 * DEG) < 3 * sigma).all()


def test_allan_gives_no_noise_terms_of_a_rounded_record():
    rng = np.random.default_rng(3)
    t = np.arange(20_000) / 100.0
    white = 0.1 * DEG * rng.standard_normal(len(t)) + 0.03
    coarse = characterise_noise(t, 0.4 * DEG * np.rint(white / 0.4 / DEG), "gz")
    assert all(term.value is None for term in coarse.terms.values())
    assert any("steps of 0.4 deg/s" in note and "no noise term is given" in note for note in coarse.notes)
    fine = characterise_noise(t, 0.1 * DEG * np.rint(white / 0.1 / DEG), "gz")
    assert fine.terms["N"].value == pytest.approx(0.1 * DEG * 0.1 * np.sqrt(1 + 1 / 12), rel=0.03)
    with pytest.raises(InputError, match="the noise of the sensor does not show"):
        blind = np.where(rng.random(len(t)) < 0.01, 0.4 * DEG, 0.0)
        characterise_noise(t, blind, "gz")
