"""Doses against dense likelihoods, drawn likelihood ratios and their own targets."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from gap_matrix import cases, dose, effects, sensor
from gap_matrix.effects import Effect

SEED = 7


@pytest.fixture(scope="module")
def minute():
    return cases.setup(SEED, duration=60.0)


@pytest.fixture(scope="module")
def meter(minute):
    return dose.Meter(minute)


@pytest.mark.parametrize(
    ("name", "target"),
    [
        (name, target)
        for name in effects.KINDS
        for target in dose.STRENGTHS.values()
        if name not in ("sample_repeat", "outliers") or target == dose.STRONG
    ],
)
def test_a_dose_reaches_its_target(minute, meter, name, target):
    made, gain = meter.dose(cases.hidden_effect(minute, name), target)
    assert gain == pytest.approx(target, rel=0.03)
    assert effects.possible(made)


@pytest.mark.parametrize("name", ["wheel_radius", "accel_bias", "time_offset", "lever_arm", "gyro_lag"])
def test_what_a_record_really_gains_is_the_dose_within_its_chance(minute, meter, name):
    """The log-likelihood ratio of a record with noise is normal with mean G and variance 2 G."""
    effect, gain = meter.dose(cases.hidden_effect(minute, name, "left"), dose.MEDIUM)
    record, taken, warmth = (
        cases.record(minute, "left", [effect]),
        minute.taken["left"],
        minute.drive.temperature,
    )
    base = meter._nodes["left"]
    found = effects.settings([effect], "left")
    true = sensor.clean(cases.channels(minute, "left", [effect]), found, taken, warmth)
    without = sensor.clean(cases.channels(minute, "left", []), {}, record.t, warmth)
    misses = [
        dose.angle_free_gain(record.values - expected, base.turning, base.sigma, base.drift)
        for expected in (without, true)
    ]
    assert misses[0] - misses[1] == pytest.approx(gain, abs=4.0 * np.sqrt(2.0 * gain))


def test_a_drive_that_cannot_show_an_effect_says_so():
    bench = dose.Meter(cases.setup(SEED, "bench", 60.0))
    with pytest.raises(ValueError, match="track_width: this drive shows 0"):
        bench.dose(cases.hidden_effect(bench.setup, "track_width"), dose.FAINT)


def test_what_a_shift_of_the_wheel_angle_imitates_gains_nothing(meter):
    turn = Effect("node_misalignment", "left", {"x": 0.0, "y": 0.0, "z": 1e-3})
    assert meter.gain(turn) < 0.01
    assert meter.gain(replace(turn, parameters={"x": 1e-3, "y": 0.0, "z": 0.0})) > 100.0


def test_the_gain_without_the_angle_is_the_gaussian_quadratic_form():
    rng = np.random.default_rng(5)
    n = 30
    difference, turning = rng.normal(size=(2, n, 6))
    sigma, drift = rng.uniform(0.5, 2.0, (n, 6)), rng.uniform(0.0, 0.1, n)
    walk = np.cumsum(drift)
    angle = 1e4 + np.minimum.outer(walk, walk)
    by = np.repeat(np.arange(n), 6)
    covariance = (
        np.diag(sigma.ravel() ** 2) + np.outer(turning.ravel(), turning.ravel()) * angle[np.ix_(by, by)]
    )
    dense = 0.5 * difference.ravel() @ np.linalg.solve(covariance, difference.ravel())
    assert dose.angle_free_gain(difference, turning, sigma, drift) == pytest.approx(dense, rel=1e-6)


def test_the_gain_of_a_random_walk_is_that_of_its_dense_covariance():
    n, k, sigma, dt = 80, 0.3, 0.7, 0.01
    steps = np.arange(1, n + 1)
    ratio = np.eye(n) + k**2 * dt / sigma**2 * np.minimum.outer(steps, steps)
    dense = 0.5 * (np.trace(ratio) - n - np.linalg.slogdet(ratio)[1])
    assert dose.random_walk_gain(k, np.full(n, sigma), dt) == pytest.approx(dense, rel=1e-9)


def test_the_gain_of_outliers_and_of_clipping_is_the_mean_of_drawn_likelihood_ratios():
    rng = np.random.default_rng(11)
    count, p, size = 2_000_000, 0.01, 4.0
    noise = rng.standard_normal(count)
    y = noise + size * rng.standard_normal(count) * (rng.random(count) < p)
    mixed = (1 - p) * norm.pdf(y) + p * norm.pdf(y, scale=np.hypot(1, size))
    drawn = np.log(mixed / norm.pdf(y))
    doubt = 3.0 * np.std(drawn) * np.sqrt(count)
    assert dose.outlier_gain(p, size, count) == pytest.approx(np.sum(drawn), abs=doubt)

    lsb, sigma, true, limit = 0.1, 1.0, 1.5, 2.0
    clipped = true + sigma * noise > limit
    each = norm.logsf(limit, true, sigma) - np.log(lsb * norm.pdf(limit, true, sigma))
    gain = dose.clipping_gain(limit, np.full((count, 1), true), np.full((count, 1), sigma), lsb)
    assert gain == pytest.approx(np.sum(clipped) * each, rel=0.02)
