"""A bus that takes 0.9 ms a call beyond the wire, as SoftI2C of an ESP32 does: every sample arrives."""

import numpy as np
import pytest

from hubodo.emulator.board.settings import Clock
from hubowire import messages as m
from virtual_runs import matched, of, run


@pytest.mark.parametrize("rate", [104, 208, 416])
def test_on_a_slow_bus_every_sample_arrives_through_the_fifo(rate):
    sent, truth, stats = run(10, clock=Clock(call_cost_us=900), config={"rate_hz": rate, "fifo": True})
    matched_rows = matched(sent, truth)
    assert (np.diff(matched_rows[:, 0]) == 1).all() and (np.diff(matched_rows[:, 2]) == 1).all()
    assert truth.t[int(matched_rows[-1, 0])] > 9.5
    health = of(sent, m.Health)[-1]
    assert (health.samples_missed, health.fifo_overruns, health.frames_dropped, health.faults) == (0, 0, 0, 0)
    assert stats["resets"] == []


@pytest.mark.parametrize("rate", [104, 208])
def test_polled_on_a_slow_bus_hardly_a_sample_is_lost_and_those_are_counted(rate):
    """Two polls and a read take most of a period; which samples that costs depends on the beat of the two."""
    lost, sampled = 0, 0
    for cost_us in (880, 900, 920):
        sent, truth, _ = run(5, clock=Clock(call_cost_us=cost_us), config={"rate_hz": rate, "fifo": False})
        rows = matched(sent, truth)
        missing, jump = np.diff(rows[:, 0]) - 1, np.diff(rows[:, 2]) - 1
        assert np.array_equal(missing, jump)
        lost, sampled = lost + missing.sum(), sampled + len(truth.t)
        at = max(i for i, (_, message) in enumerate(sent) if isinstance(message, m.Health))
        health, before = sent[at][1], matched(sent[:at], truth)
        assert (np.diff(before[:, 2]) - 1).sum() <= health.samples_missed <= jump.sum()
        assert truth.t[-1] - health.t_us * 1e-6 < 1.1 and health.faults == 0
    assert lost <= 0.01 * sampled


@pytest.mark.parametrize(("rate", "cost_us"), [(208, 2000), (104, 4000)])
def test_polling_that_a_bus_cannot_hold_is_given_up_for_the_fifo_and_told(rate, cost_us):
    sent, truth, _ = run(10, clock=Clock(call_cost_us=cost_us), config={"rate_hz": rate, "fifo": False})
    matched_rows = matched(sent, truth)
    assert of(sent, m.Health)[-1].faults == m.Fault.POLLED_TOO_FAST
    late = matched_rows[truth.t[matched_rows[:, 0].astype(int)] > 5.0]
    assert len(late) > 4.5 * rate and np.all(np.diff(late[:, 0]) == 1) and np.all(np.diff(late[:, 2]) == 1)


def test_a_rate_that_is_never_polled_comes_through_the_fifo_and_says_why():
    sent, truth, _ = run(3, config={"rate_hz": 416, "fifo": False})
    matched_rows = matched(sent, truth)
    assert np.all(np.diff(matched_rows[:, 0]) == 1) and len(matched_rows) > 2.5 * 416
    assert of(sent, m.Health)[-1].faults == m.Fault.POLLED_TOO_FAST
