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

from hubodo.sensors.warmup.recursive_least_squares import RecursiveLeastSquares

FORGETTING = [1_027_604, 964_690]
"""0.98 and 0.92."""
STEP = math.radians(0.07)
COUNT = 10_000
NAMES = ("still", "drive", "saturating", "steps", "full swing", "constant")


@cache
def signals(count):
    """(count, 6, 6) of the six signals of the Kalman filter's test, three and three as gyro axes."""
    return [table[:count].copy() for table in hour_of_signals(7)]


@cache
def filtered_signals(forgetting):
    """Of both tables of `signals(COUNT)`."""
    return [filtered(table, forgetting) for table in signals(COUNT)]


def filtered(table, forgetting, bias_q14=0):
    """(N, 3) rates in steps, and the filter."""
    node = rls_filter.RlsFilter(forgetting)
    for axis in range(3):
        node.reset(axis, bias_q14)
    flat, rates = table.reshape(-1).tolist(), np.empty((len(table), 3))
    for n in range(len(table)):
        node.update(flat, 6 * n, 1)
        rates[n] = [node.rate_q8(axis) / 256 for axis in range(3)]
    return rates, node


@pytest.mark.parametrize("forgetting", FORGETTING)
def test_each_sample_moves_it_as_the_float_version_with_the_same_history(forgetting):
    """Before each sample the float version is given the node's last rate, which is its regressor.

    Left to itself the printed filter multiplies a difference of a thousandth of a step by up to a million
    where hardly any noise excites it, so that two of them part there whatever computes them.
    """
    worst = {}
    for which, table in enumerate(signals(COUNT)):
        rates, node = filtered_signals(forgetting)[which]
        assert node.saturations <= 8
        for axis in range(3):
            theirs = RecursiveLeastSquares(forgetting / 2**20)
            off = np.empty(COUNT)
            for n, z in enumerate((table[:, axis] * STEP).tolist()):
                off[n] = abs(theirs.update(z) / STEP - rates[n, axis])
                n_, _, *others = theirs._state
                theirs._state = (n_, rates[n, axis] * STEP, *others)
            worst[NAMES[3 * which + axis]] = (float(np.median(off)), float(off.max()))
    print(f"lambda {forgetting / 2**20:.2f}: median and worst difference in steps {worst}")
    assert worst["still"][1] < 1 / 32
    assert worst["drive"][1] < 1 / 8
    # Signals of 65,536 steps: small floats round to 2^-18 of them, and the memory holds fifty such roundings.
    assert max(row[1] for row in worst.values()) < 65_536 * 2**-14
    assert max(row[0] for row in worst.values()) < 1 / 4


@pytest.mark.parametrize("forgetting", FORGETTING)
def test_left_to_itself_it_stays_within_a_thirty_second_of_a_step_where_noise_excites_it(forgetting):
    table = signals(COUNT)[0]
    rates, _ = filtered_signals(forgetting)[0]
    theirs = RecursiveLeastSquares(forgetting / 2**20).run(table[:, 0] * STEP) / STEP
    off = np.abs(rates[:, 0] - theirs)
    print(f"lambda {forgetting / 2**20:.2f}: still, {COUNT} samples, worst difference {off.max():.4f} steps")
    assert off.max() < 1 / 32


def test_noise_at_a_constant_rate_is_kept_to_the_golden_ratio_as_the_printed_form_keeps_it():
    """Of its last 6700 samples on three axes: after four lengths of its memory."""
    table = np.zeros((10_700, 6), dtype=np.int64)
    table[:, :3] = np.round(np.random.default_rng(11).normal(0.0, 20.0, (len(table), 3)))
    rates, _ = filtered(table, (1 << 20) - 1024)
    golden = (math.sqrt(5) - 1) / 2
    assert np.mean(np.var(rates[4_000:], axis=0)) / 400 == pytest.approx(golden, abs=0.03)


def test_after_2_to_the_20_samples_the_level_no_longer_leads():
    """The line through n = 0 would lead 30,000 steps by 1.4 there; and an hour before by more."""
    node = rls_filter.RlsFilter(FORGETTING[0])
    for axis in range(3):
        node.reset(axis, 0)
    flat = [30_000, 0, 0, 0, 0, 0] * 255
    node._n, node._energy = (1 << 20) - 1000, 50 << 18
    for _ in range(20):
        node.update(flat, 0, 255)
    assert abs(node.rate_q8(0) / 256 - 30_000) < 0.1


@pytest.mark.parametrize("rate", [0, 1, -4000])
def test_thousands_of_equal_samples_do_not_wind_it_up(rate):
    """A gain that grew by a memory of 0.92 would be beyond any float after nine thousand."""
    table = np.zeros((10_000, 6), dtype=np.int64)
    table[:, :3] = rate
    table[9_000:, :3] = np.round(5000 + np.random.default_rng(1).normal(0, 1.0, (1000, 3)))
    rates, _ = filtered(table, FORGETTING[1])
    # The line through n = 0 leads by what it gains in as many samples as the memory has.
    lead = 5000 / 9_000 / (1 - FORGETTING[1] / 2**20)
    assert np.abs(rates[9_000 + 100 :] - 5000).max() < 4 + lead


def test_the_bias_stays_but_for_the_warm_up():
    table = signals(500)[0]
    rates, node = filtered(table, FORGETTING[0], 12 << 14)
    assert [node.bias_q12(axis) for axis in range(3)] == [12 << 12] * 3
    node.drift(2, 3 << 16)
    assert node.bias_q12(2) == (12 << 12) + (3 << 10)
    table[:, :3] -= 12
    assert np.array_equal(filtered(table, FORGETTING[0])[0], rates), "taken off the samples"


@hypothesis_settings(max_examples=25, deadline=None)
@given(
    st.lists(st.tuples(SAMPLES, SAMPLES, SAMPLES), min_size=1, max_size=60),
    st.integers(1 << 19, (1 << 20) - 1024),
    st.integers(-(1 << 28), 1 << 28),
    st.sampled_from([0, 1000, (1 << 20) - 3]),
)
def test_no_intermediate_needs_more_than_31_bits(samples, forgetting, bias_q14, already):
    node = rls_filter.RlsFilter(SmallInt(forgetting))
    # Lists instead of int32 arrays, so that the state is checked as well.
    node._axes = [[SmallInt(0)] * 9 for _ in range(3)]
    for axis in range(3):
        node.reset(axis, SmallInt(bias_q14))
    if already:
        node._n, node._energy = SmallInt(already), SmallInt((1 << 38) // ((1 << 20) - forgetting))
    flat = [SmallInt(value) for row in samples for value in (*row, 0, 0, 0)]
    for _ in range(3):
        node.update(flat, 0, len(samples))


def test_the_longest_memory_fits_its_energy():
    node = rls_filter.RlsFilter((1 << 20) - 1024)
    node._axes = [[SmallInt(0)] * 9 for _ in range(3)]
    node._n = SmallInt(1 << 20)
    node._energy = SmallInt((1 << 28) - 1)
    for _ in range(100):
        gain = node._next()
    assert abs(gain / 2**25 - 1024 / 2**20) < 1e-6


def test_an_estimator_is_chosen_by_its_kind():
    for kind, wanted in (
        (wire.FILTER_KIND_OFF, type(None)),
        (wire.FILTER_KIND_KALMAN, bias_filter.KalmanFilter),
        (wire.FILTER_KIND_RLS, rls_filter.RlsFilter),
    ):
        _, _, least, most = settings.remote(wire.CONFIG_KEY_FILTER_KIND)
        assert least <= kind <= most
        assert type(bias_choice.estimator({**settings.DEFAULTS, "filter_kind": kind})) is wanted
