"""The overlapping Allan deviation: against allantools, by invariances, with gaps, outliers and odd stamps."""

import allantools
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hubodo.errors import InputError
from hubodo.sensors.allan.deviation import allan_deviation, averaging_factors
from hubodo.sensors.even_grid import place_on_grid

SEED = 952


def test_it_agrees_with_allantools_to_1e_10_at_octaves_and_at_any_factor():
    rng = np.random.default_rng(SEED)
    samples = np.cumsum(rng.normal(size=50_000)) * 1e-4 + rng.normal(size=50_000) + 7.0
    for taus in ("octave", "decade", [0.01 * m for m in (1, 3, 7, 1000, 4567, 12_345)]):
        tau, theirs, _, pairs = allantools.oadev(samples, rate=100.0, data_type="freq", taus=taus)
        factors = np.rint(tau * 100).astype(int)
        ours = allan_deviation(samples, 0.01, factors)
        assert np.max(np.abs(ours.adev / theirs - 1)) < 1e-10
        assert list(ours.pairs) == list(pairs)


def test_it_agrees_with_the_published_values_of_nist_sp_1065():
    """Overlapping deviation of the 1000-point test suite of NIST SP 1065, section 12.4 (page 107)."""
    numbers = np.empty(1000)
    state = 1234567890
    for k in range(1000):
        numbers[k] = state / 2147483647
        state = 16807 * state % 2147483647
    result = allan_deviation(numbers, 1.0, [1, 10, 100])
    assert result.adev == pytest.approx([2.922319e-01, 9.159953e-02, 3.241343e-02], rel=1e-6)


@given(
    st.integers(2, 400),
    st.floats(-1e3, 1e3),
    st.floats(1e-3, 1e3),
    st.integers(0, 2**31),
    st.floats(1e-4, 10.0),
)
def test_an_offset_changes_nothing_and_a_factor_goes_through(count, offset, factor, seed, dt):
    samples = np.random.default_rng(seed).normal(size=count)
    plain, other = allan_deviation(samples, dt), allan_deviation(samples * factor + offset, dt)
    assert other.adev == pytest.approx(plain.adev * factor, rel=1e-6, abs=1e-9)
    assert np.array_equal(plain.factors, averaging_factors(count))
    assert plain.tau == pytest.approx(plain.factors * dt)


def test_missing_samples_are_not_invented_and_the_deviation_stays_that_of_the_complete_record():
    rng = np.random.default_rng(SEED)
    samples = rng.normal(size=200_000) + 5.0 + np.cumsum(rng.normal(0, 0.01, 200_000))
    present = rng.random(200_000) > 0.02
    present[50_000:53_000] = False
    complete = allan_deviation(samples, 0.01)
    gappy = allan_deviation(np.where(present, samples, 1e9), 0.01, present=present)
    both = np.isin(complete.factors, gappy.factors)
    error = gappy.adev / complete.adev[both] - 1
    # With 2 % of the samples missing white noise rises by 1 %; the longest windows lose pairs at the gap.
    assert np.all(np.abs(error[gappy.tau < 50]) < 0.03)
    assert gappy.pairs[0] < complete.pairs[0]


def test_a_record_without_missing_samples_gives_the_same_by_both_ways():
    samples = np.random.default_rng(SEED).normal(size=5000)
    present = np.ones(5001, bool)
    present[-1] = False
    # Below ten samples, nine tenths of a window are the whole window.
    gappy = allan_deviation(np.append(samples, 0.0), 1.0, [1, 4, 9], present)
    assert gappy.adev == pytest.approx(allan_deviation(samples, 1.0, [1, 4, 9]).adev, rel=1e-9)


def test_gaps_and_outliers_are_found_reported_and_left_empty():
    rng = np.random.default_rng(SEED)
    count = 20_000
    t = np.arange(count) * 0.01 + rng.normal(0, 2e-4, count)
    values = rng.normal(0, 0.1, count)
    values[[1000, 7000]] = [3.0, -2.0]
    retained = np.ones(count, bool)
    retained[5000:5100] = retained[9000] = False
    grid = place_on_grid(t[retained], values[retained])
    assert len(grid.values) == count
    assert [(round(at / 0.01), missing) for at, missing in grid.gaps] == [(4999, 100), (8999, 1)]
    assert np.rint(grid.outliers / 0.01).tolist() == [1000, 7000]
    assert grid.missing == 103
    assert grid.dt == pytest.approx(0.01, rel=1e-5)
    assert grid.jitter == pytest.approx(0.02, rel=0.1)
    assert "2 gaps, 101 samples" in grid.notes[0]
    assert "2 outliers" in grid.notes[1]


def test_bursty_time_stamps_are_reported_and_spread_evenly():
    values = np.random.default_rng(SEED).normal(size=5000)
    t = np.repeat(np.arange(500) * 0.1, 10) + np.tile(np.arange(10) * 1e-4, 500)
    grid = place_on_grid(t, values)
    assert grid.dt == pytest.approx(0.01, rel=0.01)
    assert not grid.gaps
    assert "are not on an even grid" in grid.notes[0]


def test_gaussian_noise_and_coarse_steps_have_no_outliers():
    for seed in range(20):
        values = np.random.default_rng(seed).normal(0, 0.4, 100_000)
        for built in (values, np.rint(values), np.rint(values * 20)):
            assert len(place_on_grid(np.arange(100_000) * 0.01, built).outliers) == 0, seed


@pytest.mark.parametrize(
    ("t", "values", "words"),
    [
        (np.arange(5.0), np.arange(5.0), "5 samples are too few"),
        (np.arange(100.0), np.full(100, 0.25), "all 100 samples equal 0.25: the sensor is stuck"),
        (np.append(np.arange(99.0), 3.0), np.arange(100.0), "time does not increase at sample 99"),
        (np.arange(100.0), np.append(np.arange(99.0), np.nan), "not finite"),
    ],
)
def test_records_that_say_nothing_are_refused_in_words(t, values, words):
    with pytest.raises(InputError, match=words):
        place_on_grid(t, values)


def test_one_sample_or_a_wrong_interval_is_refused():
    with pytest.raises(InputError, match="at least 2 samples"):
        allan_deviation(np.ones(1), 1.0)
    with pytest.raises(InputError, match="not a positive time"):
        allan_deviation(np.ones(9), 0.0)
