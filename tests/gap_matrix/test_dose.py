"""Gains of effects against dense likelihoods, drawn likelihood ratios and target gains."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from gap_matrix import cases, dose, effects, sensor
from gap_matrix.effects import Effect
from repetitions import each_value_first

SEED = 7


@pytest.fixture(scope="module")
def setup():
    return cases.draw_setup(SEED, duration=60.0)


@pytest.fixture(scope="module")
def meter(setup):
    return dose.GainMeter(setup)


@pytest.mark.parametrize(
    ("name", "target"),
    [
        *((name, dose.STRONG_NATS) for name in ("sample_repeat", "outliers")),
        *each_value_first(
            [name for name in effects.KINDS if name not in ("sample_repeat", "outliers")],
            list(dose.STRENGTHS.values()),
        ),
    ],
)
def test_a_scaled_effect_reaches_its_target_gain(setup, meter, name, target):
    scaled_effect, gain = meter.scale_to_gain(cases.draw_hidden_effect(setup, name), target)
    assert gain == pytest.approx(target, rel=0.03)
    assert effects.is_possible(scaled_effect)


@pytest.mark.parametrize("name", ["wheel_radius", "accel_bias", "time_offset", "lever_arm", "gyro_lag"])
def test_the_log_likelihood_ratio_of_a_record_agrees_with_the_expected_gain(setup, meter, name):
    """The log-likelihood ratio of a noisy record is Gaussian with mean G and variance 2 G."""
    effect, gain = meter.scale_to_gain(cases.draw_hidden_effect(setup, name, "left"), dose.MEDIUM_NATS)
    record, sample_times, temperature = (
        cases.simulate_node_record(setup, "left", [effect]),
        setup.sample_times["left"],
        setup.drive.temperature,
    )
    node_data = meter._nodes["left"]
    parameters = effects.parameters_on_node([effect], "left")
    readings_with_effect = sensor.compute_clean_readings(
        cases.compute_node_readings(setup, "left", [effect]), parameters, sample_times, temperature
    )
    readings_without_effect = sensor.compute_clean_readings(
        cases.compute_node_readings(setup, "left", []), {}, record.t, temperature
    )
    square_sums = [
        dose.gain_with_free_angle(
            record.values - expected,
            node_data.angle_derivative,
            node_data.sigma,
            node_data.angle_walk_variance,
        )
        for expected in (readings_without_effect, readings_with_effect)
    ]
    assert square_sums[0] - square_sums[1] == pytest.approx(gain, abs=4.0 * np.sqrt(2.0 * gain))


def test_an_effect_that_the_drive_cannot_show_is_refused():
    bench = dose.GainMeter(cases.draw_setup(SEED, "bench", 60.0))
    with pytest.raises(ValueError, match="track_width: this drive shows 0"):
        bench.scale_to_gain(cases.draw_hidden_effect(bench.setup, "track_width"), dose.FAINT_NATS)


def test_an_effect_equal_to_a_shift_of_the_wheel_angle_gains_nothing(meter):
    misalignment = Effect("node_misalignment", "left", {"x": 0.0, "y": 0.0, "z": 1e-3})
    assert meter.gain(misalignment) < 0.01
    assert meter.gain(replace(misalignment, parameters={"x": 1e-3, "y": 0.0, "z": 0.0})) > 100.0


def test_the_gain_with_a_free_angle_is_the_quadratic_form_of_the_dense_gaussian():
    rng = np.random.default_rng(5)
    n = 30
    difference, angle_derivative = rng.normal(size=(2, n, 6))
    sigma, angle_walk_variance = rng.uniform(0.5, 2.0, (n, 6)), rng.uniform(0.0, 0.1, n)
    walk = np.cumsum(angle_walk_variance)
    angle = 1e4 + np.minimum.outer(walk, walk)
    sample_index = np.repeat(np.arange(n), 6)
    covariance = (
        np.diag(sigma.ravel() ** 2)
        + np.outer(angle_derivative.ravel(), angle_derivative.ravel())
        * angle[np.ix_(sample_index, sample_index)]
    )
    dense = 0.5 * difference.ravel() @ np.linalg.solve(covariance, difference.ravel())
    assert dose.gain_with_free_angle(
        difference, angle_derivative, sigma, angle_walk_variance
    ) == pytest.approx(dense, rel=1e-6)


def test_the_gain_of_a_random_walk_matches_its_dense_covariance():
    n, k, sigma, dt = 80, 0.3, 0.7, 0.01
    indices = np.arange(1, n + 1)
    ratio = np.eye(n) + k**2 * dt / sigma**2 * np.minimum.outer(indices, indices)
    dense = 0.5 * (np.trace(ratio) - n - np.linalg.slogdet(ratio)[1])
    assert dose.random_walk_gain(k, np.full(n, sigma), dt) == pytest.approx(dense, rel=1e-9)


def test_gains_of_outliers_and_clipping_match_drawn_likelihood_ratios():
    rng = np.random.default_rng(11)
    count, p, size = 500_000, 0.01, 4.0
    noise = rng.standard_normal(count)
    y = noise + size * rng.standard_normal(count) * (rng.random(count) < p)
    mixture = (1 - p) * norm.pdf(y) + p * norm.pdf(y, scale=np.hypot(1, size))
    log_ratios = np.log(mixture / norm.pdf(y))
    tolerance = 3.0 * np.std(log_ratios) * np.sqrt(count)
    assert dose.outlier_gain(p, size, count) == pytest.approx(np.sum(log_ratios), abs=tolerance)

    lsb, sigma, readings_with_effect, limit = 0.1, 1.0, 1.5, 2.0
    clipped = readings_with_effect + sigma * noise > limit
    nats_per_sample = norm.logsf(limit, readings_with_effect, sigma) - np.log(
        lsb * norm.pdf(limit, readings_with_effect, sigma)
    )
    gain = dose.clipping_gain(
        limit, np.full((count, 1), readings_with_effect), np.full((count, 1), sigma), lsb
    )
    assert gain == pytest.approx(np.sum(clipped) * nats_per_sample, rel=0.02)
