"""Device clocks: wrap-around, skew, jitter, asymmetric delays, restarts; sigma covers the truth."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hubodo.ingest.node.clock import TICK_PERIOD_US, ClockEstimate, ClockSync, TickUnwrapper
from hubodo.units import NS_PER_S
from repetitions import first_and_more

T0 = 1_700_000_000 * NS_PER_S


class SimulatedClock:
    """A node's clock with rate error `skew_ppm`, read in whole microseconds."""

    def __init__(self, skew_ppm: float, start_us: int = 12_345) -> None:
        self.skew, self.start_us = skew_ppm * 1e-6, start_us

    def us(self, host_ns: float) -> int:
        return int(self.start_us + (host_ns - T0) * 1e-3 * (1 + self.skew))

    def host(self, device_ns: int) -> float:
        return T0 + (device_ns - self.start_us * 1000) / (1 + self.skew)


def run_exchanges(sync, clock, rng, *, seconds, request_delay, reply_delay, period=1.0):
    """Run exchanges with delays drawn by the two callables, s; yield after each."""
    t = float(T0)
    for _ in range(int(seconds / period)):
        t += period * NS_PER_S
        there = t + request_delay(rng) * NS_PER_S
        back = there + 50e3 + reply_delay(rng) * NS_PER_S
        sync.add_exchange(int(t), clock.us(there), clock.us(there + 50e3), int(back))
        yield t


def last(times):
    *_, t = times
    return t


def error_ns(sync, clock, device_us):
    device_ns = device_us * 1000
    return float(sync.to_host_ns(np.array([device_ns], np.int64))[0]) - clock.host(device_ns)


def quick(rng):
    return 0.0003 + rng.exponential(0.0002)


@pytest.mark.parametrize("skew_ppm", [-100, -3, 0, 40, 100])
@pytest.mark.parametrize("seed", [0, 1, *first_and_more(*range(2, 12))])
def test_skew_and_jitter_are_followed_within_three_stated_sigmas(skew_ppm, seed):
    rng, sync, clock = np.random.default_rng(seed), ClockSync(), SimulatedClock(skew_ppm)
    ratios = []
    for t in run_exchanges(sync, clock, rng, seconds=120, request_delay=quick, reply_delay=quick):
        device_us = clock.us(t + 0.5 * NS_PER_S)
        ratios.append(abs(error_ns(sync, clock, device_us)) / sync.sigma_ns(device_us * 1000))
    assert max(ratios) < 3, f"seed {seed}"
    estimate = sync.estimate()
    assert abs(estimate.drift * 1e6 + skew_ppm) < 3 * estimate.drift_sigma * 1e6 + 0.1
    assert estimate.sigma_ns < 1e6


@pytest.mark.parametrize("seed", [0, 1, *first_and_more(*range(2, 12))])
def test_a_lopsided_delay_that_never_averages_out_stays_inside_two_sigmas(seed):
    rng, sync, clock = np.random.default_rng(seed), ClockSync(), SimulatedClock(25)

    def slow(rng):
        return 0.008 + rng.exponential(0.0005)

    t = last(run_exchanges(sync, clock, rng, seconds=300, request_delay=quick, reply_delay=slow))
    device_us = clock.us(t)
    error = abs(error_ns(sync, clock, device_us))
    assert error > 1e6  # the delay is asymmetric: an average alone would be precise but wrong
    assert error < 2 * sync.sigma_ns(device_us * 1000), f"seed {seed}"


def test_an_insignificant_drift_is_not_used_and_a_significant_one_is():
    rng = np.random.default_rng(5)
    sync, clock = ClockSync(), SimulatedClock(0)
    last(run_exchanges(sync, clock, rng, seconds=3, request_delay=quick, reply_delay=quick))
    assert not sync.estimate().drift_used
    sync, clock = ClockSync(), SimulatedClock(80)
    last(run_exchanges(sync, clock, rng, seconds=60, request_delay=quick, reply_delay=quick))
    assert sync.estimate().drift_used


def test_exchanges_and_resets_are_counted():
    sync = ClockSync()
    assert (sync.source, sync.exchanges, sync.resets) == ("none", 0, 0)
    sync.add_arrival(1_000_000, T0)
    assert (sync.source, sync.exchanges) == ("one way", 0)
    for k in range(1, 4):
        assert sync.add_exchange(
            T0 + k * NS_PER_S, k * 1_000_000, k * 1_000_000, T0 + k * NS_PER_S + 1_000_000
        )
        assert (sync.source, sync.exchanges) == ("two way", k)
        assert sync.estimate().exchanges == k
    assert not sync.add_exchange(T0 + 4 * NS_PER_S, 4_000_000, 4_000_000, T0 + 4 * NS_PER_S - 1)
    assert sync.exchanges == 3
    sync.reset()
    assert (sync.source, sync.exchanges, sync.resets) == ("none", 0, 1)


def test_after_one_answer_the_node_read_its_clock_amid_the_round_trip_for_all_that_is_known():
    """Uniform over the round trip: offset at its middle, sigma sqrt(1 / 12) of it, counted twice."""
    sync, trip = ClockSync(), 60_000_000
    sync.add_exchange(T0, 5_000_000, 5_010_000, T0 + trip + 10_000_000)
    assert sync.to_host_ns(np.array([5_005_000_000]))[0] == T0 + trip // 2 + 5_000_000
    assert sync.sigma_ns(5_005_000_000) == pytest.approx(trip / np.sqrt(12.0) * np.sqrt(2.0), rel=0.01)


def test_sigma_grows_without_answers():
    rng, sync, clock = np.random.default_rng(1), ClockSync(), SimulatedClock(60)
    t = last(run_exchanges(sync, clock, rng, seconds=60, request_delay=quick, reply_delay=quick))
    near = clock.us(t) * 1000
    for later in (60, 600):
        far = near + later * NS_PER_S
        assert sync.sigma_ns(far) > sync.sigma_ns(near)
        assert abs(error_ns(sync, clock, far // 1000)) < 3 * sync.sigma_ns(far)


def test_over_a_month_without_an_answer_the_drift_grows_as_a_random_walk():
    """The integral of a random walk of q per root second has sigma q sqrt(t³ / 3); q of a crystal is 1e-7."""
    rng, sync, clock = np.random.default_rng(7), ClockSync(), SimulatedClock(60)
    t = last(run_exchanges(sync, clock, rng, seconds=60, request_delay=quick, reply_delay=quick))
    month = 30 * 86400.0
    walk = 1e-7 * np.sqrt(month**3 / 3)
    assert sync.sigma_ns(clock.us(t) * 1000 + int(month * NS_PER_S)) * 1e-9 == pytest.approx(walk, rel=0.1)


def test_the_json_of_a_clock_is_in_seconds_and_ppm():
    estimate_json = ClockEstimate(
        offset_ns=2.5e9,
        drift=7e-5,
        drift_sigma=3e-6,
        drift_used=True,
        sigma_ns=4e5,
        source="two way",
        exchanges=9,
        resets=1,
    ).as_json()
    names = ("offset", "drift_ppm", "drift_sigma_ppm", "sigma")
    assert [estimate_json[name] for name in names] == pytest.approx([2.5, 70.0, 3.0, 4e-4])


def test_a_node_that_cannot_answer_is_followed_by_its_earliest_arrivals():
    rng, sync, clock = np.random.default_rng(2), ClockSync(), SimulatedClock(-70)
    for k in range(1, 60 * 26):
        t = T0 + k * NS_PER_S / 26
        sync.add_arrival(clock.us(t), int(t + (0.004 + rng.exponential(0.003)) * NS_PER_S))
    estimate = sync.estimate()
    assert estimate.source == "one way"
    device_us = clock.us(t)
    late = error_ns(sync, clock, device_us)
    assert 0 < late < 2 * sync.sigma_ns(device_us * 1000)
    assert late < 6e6  # near the minimum delay of 4 ms, not the mean of 7 ms
    assert abs(estimate.drift * 1e6 - 70) < 25


@pytest.mark.parametrize("seed", [0, *first_and_more(*range(1, 8))])
def test_arrivals_read_seconds_late_for_half_a_minute_do_not_move_the_clock(seed):
    rng, sync, clock = np.random.default_rng(seed), ClockSync(), SimulatedClock(30)
    backlog, errors = 0.0, []
    for k in range(1, 90 * 26):
        t = T0 + k * NS_PER_S / 26
        # Starved from 20 to 50 s: the backlog grows and shrinks at random, then is read at double speed.
        backlog = max(backlog + (rng.uniform(-0.15, 0.2) if 20 * 26 < k < 50 * 26 else -1 / 26), 0.0)
        sync.add_arrival(clock.us(t), int(t + (0.004 + rng.exponential(0.003) + backlog) * NS_PER_S))
        errors.append(error_ns(sync, clock, clock.us(t)))
    assert sync.resets == 0
    assert np.abs(errors).max() < 20e6, f"seed {seed}"


@pytest.mark.parametrize(("step_s", "within_s"), [(5.0, 69), (-5.0, 6)])
def test_arrivals_show_a_clock_that_was_set_ahead_in_seconds_and_one_that_stood_still_in_a_minute(
    step_s, within_s
):
    """A frame can be read late, never before it was sent; so lateness has to last."""
    sync, clock = ClockSync(), SimulatedClock(0)
    for k in range(1, 120 * 26):
        t = T0 + k * NS_PER_S / 26
        if k == 20 * 26:
            clock.start_us -= int(step_s * 1e6)
        sync.add_arrival(clock.us(t), int(t + 0.004 * NS_PER_S))
        if k == (20 + within_s) * 26:
            assert sync.resets == 1
            assert abs(error_ns(sync, clock, clock.us(t))) < 20e6
        elif k == (20 + within_s - 5) * 26:
            assert sync.resets == 0
    assert sync.resets == 1


def test_an_answer_replaces_arrival_times():
    sync, clock = ClockSync(), SimulatedClock(0)
    sync.add_arrival(clock.us(T0 + NS_PER_S), T0 + NS_PER_S + 15_000_000)
    t = T0 + 2 * NS_PER_S
    assert sync.add_exchange(t, clock.us(t + 200_000), clock.us(t + 250_000), t + 450_000)
    assert sync.source == "two way"
    assert abs(error_ns(sync, clock, clock.us(t))) < 200_000


def test_a_restart_resets_the_clock_estimate_and_a_clock_step_is_detected():
    rng, sync, clock = np.random.default_rng(3), ClockSync(), SimulatedClock(10)
    t = last(run_exchanges(sync, clock, rng, seconds=20, request_delay=quick, reply_delay=quick))
    stepped = SimulatedClock(10, start_us=5_000_000)
    used = []
    for k in range(1, 6):
        at = t + k * NS_PER_S
        there = at + 300_000
        used.append(sync.add_exchange(int(at), stepped.us(there), stepped.us(there), int(there + 300_000)))
    assert used[0] is False  # a single outlier has no effect
    assert used[-1] is True
    assert sync.estimate().resets == 1
    assert abs(error_ns(sync, stepped, stepped.us(at))) < 1e6
    sync.reset()
    assert sync.source == "none"
    assert sync.estimate().resets == 2


@pytest.mark.parametrize(
    ("sent", "received", "replied", "arrived"),
    [(0, 10, 5, 1_000_000), (1_000_000, 0, 0, 0), (0, 0, 2_000, 1_000_000)],
)
def test_stamps_that_contradict_each_other_are_refused(sent, received, replied, arrived):
    sync = ClockSync()
    assert sync.add_exchange(sent, received, replied, arrived) is False
    assert sync.source == "none"


@given(
    st.integers(0, TICK_PERIOD_US - 1),
    st.lists(st.integers(1, 3_000_000_000), max_size=30),
    st.integers(-400, 400),
)
def test_ticks_are_unwrapped_across_any_silence(start, pauses_us, skew_ppm):
    unwrapper, true_us = TickUnwrapper(), start
    host_us = 0.0
    assert unwrapper.unwrap(start, T0) == start
    for pause in pauses_us:
        true_us += pause
        host_us += pause / (1 + skew_ppm * 1e-6)
        assert unwrapper.unwrap(true_us % TICK_PERIOD_US, T0 + int(host_us * 1000)) == true_us


def test_a_tick_a_little_older_than_the_newest_does_not_become_a_whole_period():
    unwrapper = TickUnwrapper()
    unwrapper.unwrap(TICK_PERIOD_US - 10, T0)
    assert unwrapper.unwrap(5, T0 + 15_000) == TICK_PERIOD_US + 5
    assert unwrapper.unwrap(TICK_PERIOD_US - 3, T0 + 16_000) == TICK_PERIOD_US - 3
