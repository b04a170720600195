"""Forecasts of the bias: sigmas for any form of the warm-up, and the calibration that is written."""

import numpy as np
import pytest

from accuracy import warmup_forms
from generators import warm_ups
from generators.noise import gyro_noise
from hubodo.calibration.apply import SampleCorrection
from hubodo.calibration.file import NodeCalibration
from hubodo.sensors.warmup.bias_method import choose_bias_method
from hubodo.sensors.warmup.characterise import characterise_warmup
from hubodo.sensors.warmup.fit import fit_warmup
from hubodo.sensors.warmup.forms import RecordNoise
from repetitions import first_and_more

DEG = np.pi / 180.0


def record(bias, seed, noise=0.1):
    t = np.arange(len(bias), dtype=float)
    return t, (bias + np.random.default_rng(seed).normal(0.0, noise, len(t))) * DEG


@pytest.mark.parametrize("form", first_and_more(*reversed(warm_ups.FORMS)))
def test_the_bias_an_hour_and_three_after_the_record_is_within_the_sigma(form):
    """`tests/accuracy/warmup_forms.py` uses many seeds."""
    seed = 0
    for direction, (error, sigma) in warmup_forms.one(form, "", seed).items():
        if direction in ("forecast", "accepted model", "file"):
            print(f"{form}, seed {seed}, {direction}: {error * 3600} of {sigma * 3600} deg/h")
            assert np.all(np.abs(error) < 3.5 * sigma), direction


def test_another_form_than_the_exponential_increases_the_written_sigmas():
    """0.3 / sqrt(1 + t / 600): the fit is accepted for an hour, but its form is 50 deg/h off after 3.3."""
    t, output = record(0.3 / np.sqrt(1.0 + np.arange(3600.0) / 600.0), 3)
    report = characterise_warmup(t, output, "gz")
    assert report.accepted is report.exponential, "the form itself does not show within the hour"
    fit, later = report.exponential.fit, np.array([2 * 3600.0, 4 * 3600.0])
    off = fit.model.bias(later) - 0.3 * DEG / np.sqrt(1.0 + later / 600.0)
    believed, counted = (
        fit.bias_sigma(later),
        report.sigma["c1"] * (1.0 - np.exp(-later / fit.values["time_constant"])),
    )
    print(f"off {off / DEG * 3600} deg/h, believed {believed / DEG * 3600}, counted {counted / DEG * 3600}")
    assert np.all(np.abs(off) > 3.0 * believed) and np.all(np.abs(off) < 2.5 * counted)
    reported = report.as_json()
    assert (
        reported["c1"]["sigma"]
        == report.sigma["c1"]
        == report.calibrated_effects()["gyro_warmup"].parameters["z"].sigma
    )
    assert [row["age"] for row in reported["prediction"]][-1] == pytest.approx(t[-1] + 3 * 3600.0, abs=2.0)


def test_two_exponentials_are_written_and_corrected_as_two():
    t = np.arange(2 * 3600.0)
    bias = 0.05 + 0.3 * -np.expm1(-t / 200.0) - 0.2 * -np.expm1(-t / 1500.0)
    _, output = record(bias, 4, noise=0.05)
    report = characterise_warmup(t, output, "gz")
    assert report.accepted.fit.kind == "two exponentials"
    reported = report.as_json()
    assert reported["c1"]["value"] is None and "two exponentials" in reported["c1"]["reason"]
    effects = report.calibrated_effects()
    assert effects["gyro_warmup"].value("time_constant") == pytest.approx(200.0, rel=0.1)
    assert effects["gyro_warmup"].value("time_constant_second") == pytest.approx(1500.0, rel=0.1)
    gyro = np.column_stack([0 * t, 0 * t, bias * DEG])
    left, _ = SampleCorrection.from_calibration(NodeCalibration(effects)).apply(gyro, gyro, age=t)
    off = np.abs(left[:, 2]) / report.accepted.fit.bias_sigma(t)
    print(f"seed 4: at most {np.abs(left[:, 2]).max() / DEG:.4f} deg/s is left, {off.max():.1f} sigma")
    assert off.max() < 4.0


def test_a_model_that_the_record_does_not_determine_is_not_offered():
    """An exponential and a slow sway, to which a second exponential with c1 of thousands would be fitted."""
    wild = 0
    for seed in range(6):
        t = np.arange(3600.0)
        rng = np.random.default_rng(seed)
        bias = 0.1 * -np.expm1(-t / 400.0) + 0.01 * np.sin(t / 700.0 + rng.uniform(0, 6)) + 2e-6 * t
        _, output = record(bias, seed, noise=0.05)
        wild += not fit_warmup(t, output, "two exponentials").is_determined
        report = characterise_warmup(t, output, "gz")
        assert report.next_model is None or report.next_model.fit.is_determined
        assert report.accepted is None or report.accepted.fit.is_determined
    assert wild > 2, "else nothing was shown"


def test_slow_noise_is_random_walk_and_flicker_of_the_given_levels():
    """Independent of the sum of squares: a walk by its steps, flicker by its growth with time."""
    noise = RecordNoise(0.0, 0.0, 0.3, 0.0, 1.0)
    t = np.array([0.0, 10.0, 40.0])
    assert noise.slow_covariance(t, t) == pytest.approx(0.09 * np.minimum.outer(t, t))
    flicker = RecordNoise(0.0, 1.0, 0.0, 0.0, 1.0)
    built = np.array([gyro_noise(4096, 1.0, np.random.default_rng(s), b=1.0) for s in range(60)])
    for lag in (8, 64, 512):
        theirs = np.mean((built[:, lag:] - built[:, :-lag]) ** 2)
        ours = 2.0 * float(
            (flicker.slow_variance(t[:1]) - flicker.slow_covariance(t[:1], np.array([float(lag)])))[0, 0]
        )
        print(f"flicker changes within {lag} s by {theirs:.2f} (foreign), {ours:.2f}")
        # The difference is the largest slope: a third of the variance at most.
        assert ours == pytest.approx(theirs, rel=0.45)


@pytest.mark.parametrize(("walk", "chosen"), [(0.0, "mean"), (2e-3, "Kalman")])
def test_the_estimator_after_a_standstill_is_selected_by_held_out_error(walk, chosen):
    for seed in range(3):
        noise = gyro_noise(60_000, 0.01, np.random.default_rng(seed), n=1e-3, k=walk)
        choice = choose_bias_method(noise, 0.01)
        assert choice.chosen == chosen, (seed, choice)
        assert choice.errors[chosen] <= min(choice.errors.values()) * 1.2
        assert chosen in choice.why
    assert choose_bias_method(np.zeros(100), 0.01) is None


def test_a_bias_that_follows_a_room_without_thermometer_widens_the_sigma_and_is_named():
    """The room warms and cools in the second half of an hour; the bias follows it by 0.02 deg/s."""
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 3600.0, 6.0)
    room = 4e-4 * np.interp(t, [0.0, 2000.0, 2800.0, 3600.0], [0.0, 0.0, 1.0, 0.0])
    warm = 1e-3 * np.exp(-t / 400.0)
    noise = rng.normal(0.0, 1.2e-4, len(t))
    plain = characterise_warmup(t, warm + noise, "gz")
    disturbed = characterise_warmup(t, warm + room + noise, "gz")
    assert plain.forecast.inflation < 2.0 and plain.remarks == plain.notes
    assert disturbed.forecast.inflation > 2.0 and "missed the rest" in disturbed.remarks[-1]
    assert disturbed.as_json()["forecast_inflation"] == disturbed.forecast.inflation


def test_a_stated_form_has_the_sigma_of_that_form_and_its_errors_are_within_it():
    """Clean exponentials, forecast three hours beyond the record: coverage, and a narrower sigma."""
    pulls, shares = [], []
    for seed in range(2):
        rng = np.random.default_rng([seed, 17])
        t, bias, _ = warm_ups.warm_up("one exponential", "", 14_461, rng)
        t, values = t[:3600], (bias[:3600] + rng.normal(0.0, 0.1, 3600)) * DEG
        stated = characterise_warmup(t, values, "gz", form="exponential")
        (mean, sigma), (_, wide) = (
            result.bias(14_400.0) for result in (stated, characterise_warmup(t, values, "gz"))
        )
        pulls.append((mean / DEG - bias[14_400]) / (sigma / DEG))
        shares.append(sigma / wide)
    assert np.max(np.abs(pulls)) < 3.0 and np.median(shares) < 0.6
    assert stated.as_json()["form"] == "exponential" and "the form is stated" in stated.remarks[-1]
