"""Warm-up: fit against independent oracles, whiteness tests, next model, undetermined parameters."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import approx_fprime, curve_fit

from generators import start_gyro as start
from hubodo.effects.warmup import WARMUP_PARAMETERS, WarmupModel
from hubodo.errors import InputError
from hubodo.sensors.standstill_checks import TemperatureStep
from hubodo.sensors.warmup.characterise import characterise_warmup
from hubodo.sensors.warmup.fit import _jacobian, fit_warmup
from hubodo.sensors.warmup.whiteness import autocorrelation_test, ljung_box
from papers.filters.warmup_recursion import BiasRecursion
from repetitions import first_and_more

DEG = np.pi / 180.0
NIGHT = 12 * 3600.0


def test_the_fit_is_that_of_scipys_curve_fit_from_the_true_start():
    t, output = start.overnight(5.0, NIGHT, np.random.default_rng(1))
    ours = fit_warmup(t, output)
    theirs, covariance = curve_fit(
        lambda t, c2, c1, constant: c2 + c1 * (1 - np.exp(-t / constant)),
        t,
        output,
        (start.C2, start.C1, start.T),
    )
    assert list(ours.values.values()) == pytest.approx(theirs, rel=1e-5)
    assert list(ours.sigma.values()) == pytest.approx(np.sqrt(np.diag(covariance)), rel=1e-3)


@pytest.mark.parametrize("kind", WARMUP_PARAMETERS)
def test_the_jacobian_is_the_numerical_derivative(kind):
    t = np.linspace(0.0, 5000.0, 7)
    temperature = 25 + np.sin(t)
    names = WARMUP_PARAMETERS[kind]
    at = np.array(
        [np.log(700.0 * (k + 1)) if n.startswith("time") else 0.3 + 0.1 * k for k, n in enumerate(names)]
    )

    def value(parameters, place):
        pairs = zip(names, parameters, strict=True)
        model = WarmupModel(**{n: float(np.exp(p)) if n.startswith("time") else float(p) for n, p in pairs})
        return float(model.bias(t, temperature)[place])

    analytic = _jacobian(t, names, at, temperature)
    for place in range(len(t)):
        assert analytic[place] == pytest.approx(approx_fprime(at, value, 1e-7, place), abs=2e-6)


def test_start_is_recovered_with_sigmas_that_hold():
    """200 nights: the errors in units of the stated sigma have unit spread (1 sigma of that: 5 %)."""
    pulls = []
    for seed in range(200):
        t, output = start.overnight(20.0, NIGHT, np.random.default_rng(seed))
        fit = fit_warmup(t, output)
        truth = {"c1": start.C1, "c2": start.C2, "time_constant": start.T}
        pulls.append([(fit.values[name] - true) / fit.sigma[name] for name, true in truth.items()])
    assert np.std(pulls, axis=0) == pytest.approx([1.0, 1.0, 1.0], abs=0.2)


@given(st.floats(-1.0, 1.0), st.floats(100.0, 5000.0), st.floats(0.01, 2.0), st.floats(0.0, 4000.0))
def test_the_recursion_of_eq_6_follows_the_model_from_any_age(c1, constant, dt, age):
    model = WarmupModel(0.1, c1, constant, -0.5 * c1, 3.0 * constant)
    recursion = BiasRecursion(model, dt, age)
    result = []
    for _ in range(300):
        result.append(recursion.value())
        recursion.advance()
    exact = model.bias(age + np.arange(300) * dt)
    # The backward difference lengthens the time constant by dt / 2 on average: an error below |C1| dt / T.
    assert np.max(np.abs(result - exact)) <= 1.5 * abs(c1) * dt / constant + 1e-12


def test_the_temperature_drives_the_bias_in_a_temperature_model():
    model = WarmupModel(0.1, temperature_coefficient=0.01)
    assert model.bias(np.zeros(2), np.array([25.0, 35.0])) == pytest.approx([0.1, 0.2])
    assert BiasRecursion(model, 0.1).value(35.0) == pytest.approx(0.2)
    with pytest.raises(ValueError, match="needs the temperature"):
        model.bias(np.zeros(2))


def test_white_noise_passes_both_tests_as_often_as_stated_and_coloured_noise_does_not():
    passed = {"white": [0, 0], "coloured": [0, 0]}
    for seed in range(200):
        white = np.random.default_rng(seed).normal(size=2000)
        coloured = white[1:] + 0.3 * white[:-1]
        for name, noise in (("white", white), ("coloured", coloured)):
            passed[name][0] += autocorrelation_test(noise, 10, 200).is_white
            passed[name][1] += ljung_box(noise).is_white
    # 0.5 % of false alarms: one of 200 is expected, six or more occur once in 1600.
    assert min(passed["white"]) > 194
    assert passed["coloured"][1] == 0
    slow = np.cumsum(np.random.default_rng(0).normal(size=2000)) * 0.1
    assert not autocorrelation_test(slow, 10, 200).is_white


def test_the_autocorrelation_is_the_papers_biased_one():
    noise = np.random.default_rng(3).normal(size=300)
    test = autocorrelation_test(noise, 1, 300)
    by_hand = [np.sum(noise[:-k] * noise[k:]) / np.sum(noise**2) for k in (1, 2, 57)]
    assert test.autocorrelation[[0, 1, 56]] == pytest.approx(by_hand)
    assert test.standard_error == pytest.approx(1 / np.sqrt(300))


def test_shares_inside_the_bounds_are_those_expected_of_white_noise():
    shares = [
        (
            t.share_within_one_sigma - t.expected_share_within_one_sigma,
            t.share_within_two_sigma - t.expected_share_within_two_sigma,
        )
        for t in (
            autocorrelation_test(np.random.default_rng(s).normal(size=2000), 10, 200) for s in range(100)
        )
    ]
    assert np.mean(shares, axis=0) == pytest.approx([0, 0], abs=0.01)


def night(seed, duration=6 * 3600.0, noise=0.05, step=3.0):
    """Return means over `step` seconds; noise: deg/s per second of samples."""
    t = np.arange(0.0, duration, step)
    return t, (start.bias(t) + np.random.default_rng(seed).normal(0, noise / step**0.5, len(t))) * DEG


def test_a_second_exponential_is_recommended_if_present():
    for seed in range(3):
        t, output = night(seed)
        report = characterise_warmup(t, output - 0.2 * DEG * (1 - np.exp(-t / 300)), "gz")
        assert not report.exponential.is_white, seed
        assert report.next_model.fit.kind == "two exponentials", seed
        # The faster exponential comes first, as in the grid.
        result = report.next_model.fit.values
        assert result["time_constant"] == pytest.approx(300, rel=0.25), seed
        assert result["time_constant_second"] == pytest.approx(start.T, rel=0.25), seed


@pytest.mark.parametrize("seed", first_and_more(0, 1))
def test_a_temperature_model_is_recommended_if_it_drives_the_bias(seed):
    t, output = night(seed)
    temperature = 25 + 5 * np.sin(t / 3000) + 3 * (1 - np.exp(-t / 700))
    driven = output + 0.01 * DEG * (temperature - 25)
    report = characterise_warmup(t, driven, "gz", temperature=temperature)
    assert not report.exponential.ljung_box.is_white
    result = report.next_model.fit
    assert result.kind == "exponential and temperature"
    assert (
        abs(result.values["temperature_coefficient"] - 0.01 * DEG)
        < 4.5 * result.sigma["temperature_coefficient"]
    )
    assert (
        report.calibrated_effects()["gyro_temperature"].value("z") == result.values["temperature_coefficient"]
    )


def test_the_correct_model_has_white_residuals_and_no_recommendation():
    asked = 0
    for seed in range(20):
        t, output = night(seed)
        report = characterise_warmup(t, output, "gz")
        assert report.reason == "", seed
        asked += report.next_model is not None
    assert asked <= 1


def test_rates_are_also_given_in_deg_per_s_and_times_are_not():
    t, output = night(0)
    reported = characterise_warmup(t, output, "gz").as_json()
    for name in ("c1", "c2"):
        assert reported[name]["value_deg_per_s"] == pytest.approx(np.degrees(reported[name]["value"]))
        assert reported[name]["unit"] == "rad/s"
    assert reported["time_constant"]["unit"] == "s" and "value_deg_per_s" not in reported["time_constant"]


@pytest.mark.parametrize(
    ("kind", "seed"), first_and_more(("walk", 0), ("constant", 0), ("walk", 1), ("constant", 1))
)
def test_no_warm_up_is_reported_for_a_random_walk_or_a_constant_bias(kind, seed):
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 3 * 3600.0, 3.0)
    still = rng.normal(0, 0.12 * DEG, len(t))
    walk = rng.normal(0, 0.012 * DEG, len(t)) + np.cumsum(rng.normal(0, 1.7e-3 * DEG, len(t)))
    result = characterise_warmup(t, walk if kind == "walk" else still, "gz").as_json()
    assert result["c1"]["value"] is None
    assert result["time_constant"]["reason"]
    assert result["c2"]["value"] is not None


def test_for_too_short_a_record_the_required_length_is_reported():
    t, output = night(0, duration=900.0, noise=0.02, step=1.0)
    result = characterise_warmup(t, output, "gz").as_json()
    assert result["c1"]["value"] is None
    assert "record from power-on for" in result["c1"]["reason"]


def test_too_short_constant_and_stepped_records_are_refused_with_a_reason():
    with pytest.raises(InputError, match="too short for a warm-up"):
        characterise_warmup(np.arange(100) * 0.1, np.random.default_rng(0).normal(size=100), "gz")
    with pytest.raises(InputError, match="stuck"):
        characterise_warmup(np.arange(1000.0), np.full(1000, 0.1), "gz")
    with pytest.raises(InputError, match=r"temperature steps by \+4.00 °C at 600 s.*--end 600"):
        characterise_warmup(*night(0), "gz", temperature_step=TemperatureStep(600.0, 4.0))


def test_gaps_and_an_age_at_the_start_do_not_move_the_parameters():
    t, output = night(4)
    retained = np.ones(len(t), bool)
    retained[(t >= 4000.0) & (t < 5500.0)] = False
    later = t >= 600
    whole = characterise_warmup(t, output, "gz").exponential.fit
    cut = characterise_warmup(t[retained & later], output[retained & later], "gz", age=600.0).exponential.fit
    for name, value in whole.values.items():
        assert abs(cut.values[name] - value) < 3 * cut.sigma[name], name
