"""Both regressors of the paper's least squares in integers, beside the float version."""

import math
from functools import cache

import bias_choice
import bias_filter
import numpy as np
import pytest
import rls_filter
import settings
import wire
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from small_int import SmallInt
from test_firmware_bias_filter import SAMPLES, hour_of_signals

from hubodo.sensors.filters.recursive_least_squares import RecursiveLeastSquares
from repetitions import first_and_more

FORGETTING = [1_027_604, 964_690]
"""Forgetting factors 0.98 and 0.92 as Q20."""
STEP = math.radians(0.07)
COUNT = 10_000
NAMES = ("still", "drive", "saturating", "steps", "full swing", "constant")


@cache
def signals(count):
    """Return the six signals of the test of the Kalman filter in two tables of three gyro axes."""
    return [table[:count].copy() for table in hour_of_signals(7)]


@cache
def run_filter_on_signals(forgetting):
    """Filter both tables of `signals(COUNT)`."""
    return [run_filter(table, forgetting) for table in signals(COUNT)]


def run_filter(table, forgetting, bias_q14=0):
    """Return the rates (N, 3) in steps, and the filter."""
    node = rls_filter.RlsFilter(forgetting)
    for axis in range(3):
        node.reset(axis, bias_q14)
    flat, rates = table.reshape(-1).tolist(), np.empty((len(table), 3))
    for n in range(len(table)):
        node.update(flat, 6 * n, 1)
        rates[n] = [node.rate_q8(axis) / 256 for axis in range(3)]
    return rates, node


@pytest.mark.parametrize("forgetting", first_and_more(*FORGETTING))
def test_each_update_agrees_with_the_float_version_of_the_same_history(forgetting):
    """Before each sample the float version gets the last rate of the node, which is its regressor.

    Without this, signals with little noise amplify a difference of a thousandth of a step by up to a
    million, so that any two implementations of the published filter diverge.
    """
    worst = {}
    for which, table in enumerate(signals(COUNT)):
        rates, node = run_filter_on_signals(forgetting)[which]
        assert node.saturations <= 8
        for axis in range(3):
            float_version = RecursiveLeastSquares(forgetting / 2**20)
            difference = np.empty(COUNT)
            for n, z in enumerate((table[:, axis] * STEP).tolist()):
                difference[n] = abs(float_version.update(z) / STEP - rates[n, axis])
                n_, _, *others = float_version._state
                float_version._state = (n_, rates[n, axis] * STEP, *others)
            worst[NAMES[3 * which + axis]] = (float(np.median(difference)), float(difference.max()))
    print(f"lambda {forgetting / 2**20:.2f}: median and worst difference in steps {worst}")
    assert worst["still"][1] < 1 / 32
    assert worst["drive"][1] < 1 / 8
    # Signals have up to 65,536 steps: small floats round to 2^-18 of that, and fifty roundings add up.
    assert max(row[1] for row in worst.values()) < 65_536 * 2**-14
    assert max(row[0] for row in worst.values()) < 1 / 4


@pytest.mark.parametrize("forgetting", first_and_more(*FORGETTING))
def test_with_noise_the_filter_agrees_with_the_float_version_within_1_32_step(forgetting):
    table = signals(COUNT)[0]
    rates, _ = run_filter_on_signals(forgetting)[0]
    expected = RecursiveLeastSquares(forgetting / 2**20).run(table[:, 0] * STEP) / STEP
    difference = np.abs(rates[:, 0] - expected)
    print(f"lambda {forgetting / 2**20:.2f}: {COUNT} static samples, worst {difference.max():.4f} steps")
    assert difference.max() < 1 / 32


def test_noise_at_a_constant_rate_is_reduced_by_the_golden_ratio():
    """The last 6700 samples on three axes are used, after four time constants."""
    table = np.zeros((10_700, 6), dtype=np.int64)
    table[:, :3] = np.round(np.random.default_rng(11).normal(0.0, 20.0, (len(table), 3)))
    rates, _ = run_filter(table, (1 << 20) - 1024)
    golden = (math.sqrt(5) - 1) / 2
    assert np.mean(np.var(rates[4_000:], axis=0)) / 400 == pytest.approx(golden, abs=0.03)


def test_after_2_to_the_20_samples_the_level_has_no_lead():
    """The line through n = 0 would be ahead of 30,000 steps by 1.4 there, and by more before."""
    node = rls_filter.RlsFilter(FORGETTING[0])
    for axis in range(3):
        node.reset(axis, 0)
    flat = [30_000, 0, 0, 0, 0, 0] * 255
    node._n, node._energy = (1 << 20) - 1000, 50 << 18
    for _ in range(20):
        node.update(flat, 0, 255)
    assert abs(node.rate_q8(0) / 256 - 30_000) < 0.1


@pytest.mark.parametrize("rate", [0, 1, -4000])
def test_thousands_of_equal_samples_do_not_increase_the_gain_without_bound(rate):
    """A gain without bound (forgetting factor 0.92) would overflow after nine thousand samples."""
    table = np.zeros((10_000, 6), dtype=np.int64)
    table[:, :3] = rate
    table[9_000:, :3] = np.round(5000 + np.random.default_rng(1).normal(0, 1.0, (1000, 3)))
    rates, _ = run_filter(table, FORGETTING[1])
    # The line through n = 0 is ahead by its slope times the time constant in samples.
    lead = 5000 / 9_000 / (1 - FORGETTING[1] / 2**20)
    assert np.abs(rates[9_000 + 100 :] - 5000).max() < 4 + lead


def test_only_the_warm_up_changes_the_bias():
    table = signals(500)[0]
    rates, node = run_filter(table, FORGETTING[0], 12 << 14)
    assert [node.bias_q12(axis) for axis in range(3)] == [12 << 12] * 3
    node.drift(2, 3 << 16)
    assert node.bias_q12(2) == (12 << 12) + (3 << 10)
    table[:, :3] -= 12
    assert np.array_equal(run_filter(table, FORGETTING[0])[0], rates), (
        "the bias is subtracted from the samples"
    )


@hypothesis_settings(max_examples=25, deadline=None)
@given(
    st.lists(st.tuples(SAMPLES, SAMPLES, SAMPLES), min_size=1, max_size=60),
    st.integers(1 << 19, (1 << 20) - 1024),
    st.integers(-(1 << 28), 1 << 28),
    st.sampled_from([0, 1000, (1 << 20) - 3]),
)
def test_no_intermediate_needs_more_than_31_bits(samples, forgetting, bias_q14, n_before):
    node = rls_filter.RlsFilter(SmallInt(forgetting))
    # Lists instead of int32 arrays, so that the state consists of SmallInt too.
    node._axes = [[SmallInt(0)] * 9 for _ in range(3)]
    for axis in range(3):
        node.reset(axis, SmallInt(bias_q14))
    if n_before:
        node._n, node._energy = SmallInt(n_before), SmallInt((1 << 38) // ((1 << 20) - forgetting))
    flat = [SmallInt(value) for row in samples for value in (*row, 0, 0, 0)]
    for _ in range(3):
        node.update(flat, 0, len(samples))


def test_the_largest_forgetting_factor_does_not_overflow():
    node = rls_filter.RlsFilter((1 << 20) - 1024)
    node._axes = [[SmallInt(0)] * 9 for _ in range(3)]
    node._n = SmallInt(1 << 20)
    node._energy = SmallInt((1 << 28) - 1)
    for _ in range(100):
        gain = node._next()
    assert abs(gain / 2**25 - 1024 / 2**20) < 1e-6


def test_the_estimator_is_selected_by_its_kind():
    for kind, expected_type in (
        (wire.FILTER_KIND_OFF, type(None)),
        (wire.FILTER_KIND_KALMAN, bias_filter.KalmanFilter),
        (wire.FILTER_KIND_RLS, rls_filter.RlsFilter),
    ):
        _, _, minimum, maximum = settings.remote(wire.CONFIG_KEY_FILTER_KIND)
        assert minimum <= kind <= maximum
        assert type(bias_choice.estimator({**settings.DEFAULTS, "filter_kind": kind})) is expected_type
