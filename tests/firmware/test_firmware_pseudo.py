"""Bias from a known magnitude of the rate, in integers: as the float filter, within 31 bits."""

import math
from types import SimpleNamespace

import numpy as np
import pseudo_filter
import pseudo_init
import pytest
import settings
import small_float
import wire
from hypothesis import example, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from scipy.stats import chi2
from small_int import SmallInt

from hubodo.sensors.filters.pseudo_measurement import PseudoMeasurementFilter
from repetitions import first_and_more

LSB_NDPS = 70_000_000
ACCEL_LSB_NG = 488_000
STEP = math.radians(LSB_NDPS * 1e-9)
NOISE_UDPS = 75_000
NOISE = NOISE_UDPS / 70_000
"""Noise of a sample in gyro steps."""
SIGMA_UDPS = 5_000_000
SIGMA = SIGMA_UDPS / 70_000


def value(x):
    return (x >> 8) * 2.0 ** ((x & 255) - 128) if x else 0.0


def node_settings(**overrides):
    fixed = {"noise_udps": NOISE_UDPS, "bias_sigma_udps": SIGMA_UDPS, "gyro_scale_sigma_ppm": 0}
    return {**settings.DEFAULTS, **fixed, **overrides}


def create_init(kind, check=lambda x: x, samples=4096, **overrides):
    init = pseudo_init.PseudoInit(kind, node_settings(**overrides), SimpleNamespace(period_ns=4_807_692))
    init.start(check(samples), LSB_NDPS, ACCEL_LSB_NG)
    return init


def run_init(init, table, check=int):
    """Update with samples (N, 6) in batches of eight; return True if the initialisation has ended."""
    flat = [check(x) for x in table.reshape(-1).tolist()]
    for start in range(0, len(flat), 48):
        if init.update(flat, start, min(8, (len(flat) - start) // 6)):
            return True
    return False


def rows(rate, bias, seed, noise=NOISE):
    """Return samples (N, 6): the rate (N, 3) in steps with bias and noise, and static accelerations."""
    rng = np.random.default_rng(seed)
    table = np.zeros((len(rate), 6), dtype=np.int64)
    table[:, :3] = np.round(rate + bias + rng.normal(0, noise, rate.shape))
    table[:, 3:] = np.round(rng.normal((0, 700, 1900), 3.0, (len(rate), 3)))
    return table


def float_filter(table, stretch, rate, at_rest):
    """Return bias and sigma, in steps, of the float filter with the means of the same segments.

    At standstill the first mean is the initial bias.
    """
    count = len(table) // stretch
    means = table[: count * stretch, :3].reshape(count, stretch, 3).mean(axis=1)
    noise = NOISE * STEP / math.sqrt(stretch)
    if at_rest:
        estimator = PseudoMeasurementFilter(noise**2 * np.eye(3), means[0] * STEP, noise)
    else:
        estimator = PseudoMeasurementFilter(noise**2 * np.eye(3), sigma=SIGMA * STEP)
    estimator.run(means[1 if at_rest else 0 :] * STEP, rate * STEP)
    variance = np.diag(estimator.covariance) if at_rest else estimator.given_variance(0.0)
    return np.array(estimator.bias) / STEP, np.sqrt(variance) / STEP


def motion(kind, count, rate):
    motion_samples = np.zeros((count, 3))
    if kind == "table":
        motion_samples[:, 2] = rate
    if kind == "tumbling":
        t = np.arange(count) / 208
        axis = np.column_stack([np.cos(t), np.sin(t) * np.cos(0.3 * t), np.sin(t) * np.sin(0.3 * t)])
        motion_samples = rate * axis
    return motion_samples


@pytest.mark.parametrize(
    ("kind", "stretch", "rate"),
    [("rest", 16, 0), ("rest", 1, 0), ("rest", 250, 0), ("table", 16, 4285.7), ("table", 250, 142.9),
     ("tumbling", 1, 1428.6)],
)  # fmt: skip
def test_the_integer_filter_agrees_with_the_float_filter_within_a_hundredth_of_a_step(kind, stretch, rate):
    seed, bias = 12, np.array([31.3, -52.8, 17.1])
    table = rows(motion(kind, 4096, rate), bias, seed)
    code = wire.BIAS_KIND_REST if kind == "rest" else wire.BIAS_KIND_TABLE
    udps = round(rate * 70_000)
    init = create_init(code, bias_stretch=stretch, table_rate_udps=udps)
    assert run_init(init, table) and init.state == wire.FILTER_STATE_TRACKING and init.samples == 4096
    expected, sigma = float_filter(table, stretch, udps / 70_000, kind == "rest")
    result = np.array(init.bias_q14) / 2**14
    reported_sigma = np.array(init.sigma_q12) / 2**12
    print(
        f"{kind} {stretch}: vs float {result - expected}, vs truth {result - bias}, "
        f"sigma {sigma}, {reported_sigma}"
    )
    assert result == pytest.approx(expected, abs=0.01)
    assert reported_sigma == pytest.approx(sigma, rel=0.01, abs=2**-12)


def test_on_a_table_the_variance_of_a_sample_is_that_of_the_configured_noise():
    """The message Filter has the variance in steps squared / 256."""
    noise_udps = 20 * 70_000
    init = create_init(wire.BIAS_KIND_TABLE, noise_udps=noise_udps, table_rate_udps=300_000_000)
    motion_samples = motion("table", 4096, 300_000_000 / 70_000)
    assert run_init(init, rows(motion_samples, np.zeros(3), 1, 20.0))
    assert list(init.variance_q8) == [20**2 * 256] * 3


def test_on_a_table_the_scale_uncertainty_is_proportional_to_the_rate():
    """A scale uncertainty of 1 % at 100 deg/s gives 1 deg/s along the axis and nothing across."""
    rate = 100 / 0.07
    init = create_init(wire.BIAS_KIND_TABLE, table_rate_udps=100_000_000, gyro_scale_sigma_ppm=10_000)
    assert run_init(init, rows(motion("table", 4096, rate), np.zeros(3), 5))
    sigma = np.array(init.sigma_q12) / 2**12
    across = SIGMA**2 / rate
    assert sigma[2] == pytest.approx(math.hypot(0.01 * rate, across), rel=0.01)
    assert sigma[:2] == pytest.approx(np.full(2, SIGMA), rel=0.02)


def test_at_standstill_the_errors_agree_with_sigma():
    """The normalised errors of 60 biases from the prior are chi-square with 180 degrees of freedom."""
    total, runs = 0.0, 60
    for run in range(runs):
        bias = np.random.default_rng([3, run]).normal(0.0, SIGMA, 3)
        # Quantisation adds 1/12 step^2 to the noise of 1.15.
        table = rows(np.zeros((2000, 3)), bias, [4, run], math.sqrt(NOISE**2 - 1 / 12))
        init = create_init(wire.BIAS_KIND_REST, samples=2000)
        assert run_init(init, table)
        errors = np.array(init.bias_q14) / 2**14 - bias
        total += float(np.sum((errors / (np.array(init.sigma_q12) / 2**12)) ** 2))
    low, high = chi2.ppf([0.001, 0.999], 3 * runs)
    print(f"sum of squares {total:.1f}, band {low:.1f} .. {high:.1f}")
    assert low < total < high


def test_a_table_gives_the_bias_along_its_axis_and_leaves_the_other_sigmas_unchanged():
    table = rows(motion("table", 4096, 1428.6), np.array([2.0, -1.0, 3.0]), 7)
    init = create_init(wire.BIAS_KIND_TABLE, table_rate_udps=round(1428.6 * 70_000), bias_sigma_udps=150_000)
    assert run_init(init, table)
    sigma = np.array(init.sigma_q12) / 2**12
    assert init.bias_q14[2] / 2**14 == pytest.approx(3.0, abs=4 * sigma[2]) and sigma[2] < 0.03
    assert sigma[:2] == pytest.approx(np.full(2, 150 / 70), rel=0.01), (
        "the bias across the axis is not observable"
    )


@pytest.mark.parametrize("kind", ["steadily", "with gravity", "in one jerk"])
def test_a_turning_wheel_is_refused_and_the_bias_unchanged(kind):
    table = rows(np.zeros((2000, 3)), 5.0, 8)
    if kind == "steadily":
        table[:, 2] += 800
    elif kind == "in one jerk":
        table[1000, 1] = 3000
    else:
        table[:, 3] = np.round(2049 * np.sin(np.linspace(0, 0.5, 2000)))
    init = create_init(wire.BIAS_KIND_REST, samples=2000)
    init.bias_q14[0] = 77
    assert run_init(init, table) and init.refused == wire.REASON_WHEEL_TURNS
    assert init.state == wire.FILTER_STATE_WAITING and init.bias_q14[0] == 77


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("bias_dps, refused", [(29.7, False), (-29.7, False), (30.3, True), (-30.3, True)])
def test_a_bias_beyond_30_deg_per_s_is_refused_on_each_axis_with_either_sign(axis, bias_dps, refused):
    bias = np.zeros(3)
    bias[axis] = bias_dps / 0.07
    init = pseudo_init.PseudoInit(
        wire.BIAS_KIND_TABLE,
        node_settings(table_rate_udps=round(1428.6 * 70_000), bias_sigma_udps=10_000),
        SimpleNamespace(period_ns=4_807_692),
    )
    for k in range(3):
        init.give(k, round(bias[k] * 2**14))
    init.start(4096, LSB_NDPS, ACCEL_LSB_NG)
    assert run_init(init, rows(motion("table", 4096, 1428.6), bias, 3))
    assert init.refused == (wire.REASON_WHEEL_TURNS if refused else 0)
    assert init.samples == (0 if refused else 4096)


def test_the_initialisation_starts_from_the_known_bias_and_follows_the_warm_up():
    """The warm-up changes the bias during the initialisation: the result is the bias at the end."""
    init = pseudo_init.PseudoInit(
        wire.BIAS_KIND_REST, node_settings(bias_sigma_udps=100_000), SimpleNamespace(period_ns=4_807_692)
    )
    for axis in range(3):
        init.give(axis, 20 << 14)
    init.start(4096, LSB_NDPS, ACCEL_LSB_NG)
    ramp = np.linspace(0.0, 2.0, 4096)[:, None] * np.ones(3)
    table = rows(ramp, 20.0, 9)
    flat, ended = table.reshape(-1).tolist(), False
    for at in range(0, len(flat), 48):
        for axis in range(3):
            init.drift(axis, round(2.0 / 512 * 2**18))
        ended = init.update(flat, at, 8)
    assert ended
    assert np.array(init.bias_q14) / 2**14 == pytest.approx(np.full(3, 22.0), abs=0.15)


N_CANCELLING = 2000
NUMBERS = st.integers(-(1 << 29) + 1, (1 << 29) - 1)


@hypothesis_settings(max_examples=200)
@given(st.tuples(*[st.integers(-(1 << 27), 1 << 27)] * 3), st.integers(0, (1 << 27) - 1))
@example((0, 11656, 11720), 19814)  # The digits of 14 bits cancel.
@example((0, 4_194_303, 4_194_303), 5_931_641)
def test_the_difference_of_squares_is_exact_to_its_own_precision(d, rate):
    result = value(pseudo_filter.difference([SmallInt(x) for x in d], SmallInt(rate)))
    exact = (sum(x * x for x in d) - rate * rate) / 2**24
    # Tolerance: 2^-13 of truncation, and the rounding of a small float.
    assert result == pytest.approx(exact, rel=2e-4, abs=1e-9)


@pytest.mark.parametrize("seed", first_and_more(1, 2, 3))
def test_the_difference_of_squares_is_exact_where_its_digits_cancel(seed):
    rng = np.random.default_rng(seed)
    for _ in range(N_CANCELLING):
        size = 1 << int(rng.integers(1, 27))
        d = [int(it) for it in rng.integers(-size, size + 1, 3)]
        rate = max(0, math.isqrt(sum(x * x for x in d)) + int(rng.integers(-size // 64 - 2, size // 64 + 3)))
        exact = (sum(x * x for x in d) - rate * rate) / 2**24
        result = value(pseudo_filter.difference([SmallInt(x) for x in d], SmallInt(rate)))
        assert result == pytest.approx(exact, rel=2e-4, abs=1e-9), (d, rate)


@hypothesis_settings(max_examples=40, deadline=None)
@given(
    st.lists(st.tuples(*[NUMBERS] * 3), min_size=1, max_size=30),
    st.integers(0, (1 << 29) - 1),
    st.integers(1, 1 << 20),
    st.integers(1, 1 << 24),
)
@example([(0, -117979, 268490238), (0, 0, 0)], 0, 1, 1)
def test_no_intermediate_needs_more_than_31_bits_and_the_variance_stays_positive(means, rate, sigma, noise):
    estimator = pseudo_filter.PseudoFilter()
    estimator.bias_q16 = [SmallInt(0)] * 3
    estimator.reset(
        small_float.number(SmallInt(sigma), SmallInt(-10)), small_float.number(SmallInt(noise), SmallInt(-20))
    )
    for mean in means:
        estimator.update([SmallInt(x) for x in mean], SmallInt(rate), SmallInt(0))
        for axis in range(3):
            assert value(estimator.variance(axis)) > 0.0
            assert abs(estimator.bias_q16[axis]) <= 1 << 29


@pytest.mark.parametrize("kind", [wire.BIAS_KIND_REST, wire.BIAS_KIND_TABLE])
@pytest.mark.parametrize("stretch", first_and_more(1024, 1))
def test_the_whole_initialisation_stays_within_31_bits(kind, stretch):
    extreme = np.full((2048, 6), 32767, dtype=np.int64)
    extreme[::2] = -32768
    table = rows(np.zeros((2048, 3)), 400.0, 2) if kind == wire.BIAS_KIND_REST else extreme
    init = create_init(kind, SmallInt, 2000, bias_stretch=stretch, table_rate_udps=1_000_000_000)
    init.filter.bias_q16 = [SmallInt(x) for x in init.filter.bias_q16]
    assert run_init(init, table, SmallInt)


@hypothesis_settings(max_examples=200)
@given(st.integers(-(1 << 38), 1 << 38), st.integers(1, (1 << 24) - 1))
def test_the_mean_by_long_division_is_rounded_down(total, divisor):
    if abs(total) // divisor >= 1 << 15:
        total %= divisor << 15
    result = pseudo_filter.mean_q14(SmallInt(total >> 15), SmallInt(total & 0x7FFF), SmallInt(divisor))
    assert result == (total << 14) // divisor
