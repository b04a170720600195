"""A slow bus with 0.9 ms per call, like SoftI2C of an ESP32: every sample arrives."""

import numpy as np
import pytest

from hubodo.emulator.board.settings import Clock
from hubowire import messages as m
from virtual_runs import match_samples, messages_of, run


@pytest.mark.parametrize("rate", [104, 208, 416])
def test_on_a_slow_bus_every_sample_arrives_through_the_fifo(rate):
    sent, truth, stats = run(10, clock=Clock(call_cost_us=900), config={"rate_hz": rate, "fifo": True})
    matched_rows = match_samples(sent, truth)
    assert (np.diff(matched_rows[:, 0]) == 1).all() and (np.diff(matched_rows[:, 2]) == 1).all()
    assert truth.t[int(matched_rows[-1, 0])] > 9.5
    health = messages_of(sent, m.Health)[-1]
    assert (health.samples_missed, health.fifo_overruns, health.frames_dropped, health.faults) == (0, 0, 0, 0)
    assert stats["resets"] == []


@pytest.mark.parametrize("rate", [104, 208])
def test_polling_on_a_slow_bus_loses_few_samples_and_counts_them(rate):
    """Two polls and a read take most of a period; which samples are lost depends on the phase."""
    lost, sampled = 0, 0
    for cost_us in (880, 900, 920):
        sent, truth, _ = run(5, clock=Clock(call_cost_us=cost_us), config={"rate_hz": rate, "fifo": False})
        rows = match_samples(sent, truth)
        missing, jump = np.diff(rows[:, 0]) - 1, np.diff(rows[:, 2]) - 1
        assert np.array_equal(missing, jump)
        lost, sampled = lost + missing.sum(), sampled + len(truth.t)
        at = max(i for i, (_, message) in enumerate(sent) if isinstance(message, m.Health))
        health, before = sent[at][1], match_samples(sent[:at], truth)
        assert (np.diff(before[:, 2]) - 1).sum() <= health.samples_missed <= jump.sum()
        assert truth.t[-1] - health.t_us * 1e-6 < 1.1 and health.faults == 0
    assert lost <= 0.01 * sampled


@pytest.mark.parametrize(("rate", "cost_us"), [(208, 2000), (104, 4000)])
def test_polling_that_is_too_slow_is_replaced_by_the_fifo_with_a_fault(rate, cost_us):
    sent, truth, _ = run(10, clock=Clock(call_cost_us=cost_us), config={"rate_hz": rate, "fifo": False})
    matched_rows = match_samples(sent, truth)
    assert messages_of(sent, m.Health)[-1].faults == m.Fault.POLLED_TOO_FAST
    late = matched_rows[truth.t[matched_rows[:, 0].astype(int)] > 5.0]
    assert len(late) > 4.5 * rate and np.all(np.diff(late[:, 0]) == 1) and np.all(np.diff(late[:, 2]) == 1)


def test_a_rate_too_high_for_polling_uses_the_fifo_with_a_fault():
    sent, truth, _ = run(3, config={"rate_hz": 416, "fifo": False})
    matched_rows = match_samples(sent, truth)
    assert np.all(np.diff(matched_rows[:, 0]) == 1) and len(matched_rows) > 2.5 * 416
    assert messages_of(sent, m.Health)[-1].faults == m.Fault.POLLED_TOO_FAST
