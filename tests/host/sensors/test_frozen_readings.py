"""Readings that repeat one value are cut out or refused; coarse and slow channels are not frozen."""

import numpy as np
import pytest

import hubodo
from hubodo.errors import InputError
from hubodo.recording import Recording, Table
from hubodo.sensors.frozen_readings import find_frozen_spans
from hubodo.sensors.standstill_channel import read_standstill_channel

RATE_HZ, RANDOM_WALK = 100.0, 2e-4  # rad/√s
SPANS = ((500, 1500), (9000, 9100), (30_000, 33_000))


def frozen(seed, count=60_000):
    values = RANDOM_WALK * np.sqrt(RATE_HZ) * np.random.default_rng(seed).standard_normal(count) + 0.003
    for start, end in SPANS:
        values[start:end] = values[start]
    return np.arange(count) / RATE_HZ, values


def test_each_frozen_span_is_given_by_its_times():
    t, values = frozen(1)
    np.testing.assert_allclose(find_frozen_spans(t, values), [(t[a], t[b]) for a, b in SPANS])
    assert not find_frozen_spans(t, frozen(1)[1] + 1e-9 * np.random.default_rng(2).standard_normal(len(t)))


@pytest.mark.parametrize("step", [0.01, 0.5, 1.0, 1.8, 2.5, 5.0])
def test_coarse_steps_are_not_frozen(step):
    """White noise of 1 with a random walk that passes several codes, in steps of `step`; seeds 0 to 9."""
    for seed in range(10):
        rng = np.random.default_rng(seed)
        values = rng.standard_normal(100_000) + np.cumsum(0.01 * rng.standard_normal(100_000))
        assert not find_frozen_spans(np.arange(100_000) / 100.0, np.round(values / step) * step)


def test_a_slow_sensor_that_is_read_often_is_not_frozen():
    values = np.repeat(np.random.default_rng(4).standard_normal(600), 100)
    assert not find_frozen_spans(np.arange(len(values)) / 100.0, values)


def test_allan_cuts_frozen_readings_out_and_keeps_the_random_walk():
    results = [hubodo.from_arrays(frozen(seed)[1], t=frozen(seed)[0]).allan() for seed in range(4)]
    terms = [result.fit.terms["N"] for result in results]
    assert all(abs(term.value - RANDOM_WALK) < 3.5 * term.sigma for term in terms)
    assert all(len(result.record.excluded) == len(SPANS) for result in results)
    assert any("disturbed or frozen in 3 stretches" in note for note in results[0].notes)


def test_other_verbs_refuse_frozen_readings_with_their_time():
    t, values = frozen(3)
    other = 0.001 * np.random.default_rng(5).standard_normal((4, len(t)))
    columns = dict(zip(("gx", "gy", "ax", "ay"), other, strict=True))
    table = Table({"t": t, "gz": values, **columns, "az": 9.81 + other[0]})
    with pytest.raises(
        InputError, match=r"gz repeats one value from 5 to 15 s and in 2 more stretches.*--end 5"
    ):
        read_standstill_channel(Recording({"imu": table}), "imu", "gz", log="night")
