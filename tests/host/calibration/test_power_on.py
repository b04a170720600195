"""Power-on times of nodes from the events of a log, and the age of samples."""

import numpy as np
import pytest

from hubodo.calibration.apply import apply_calibration, find_starts, time_since_power_on
from hubodo.calibration.file import CalibratedEffect, Calibration, NodeCalibration, Quantity
from hubodo.recording import Event, Table
from hubodo.units import NS_PER_S

ZERO = 1_700_000_000 * NS_PER_S


def started(at, power_on, source="left", kind="started"):
    """Return a start event at time `at` in s; power_on: time in s, or None if not reported."""
    data = {} if power_on is None else {"power_on_ns": round(ZERO + power_on * NS_PER_S)}
    return Event(round(ZERO + at * NS_PER_S), kind, source, "", data)


def test_only_starts_of_that_node_with_a_power_on_time_are_used():
    events = [
        started(20.0, 19.0),
        started(5.0, -3.0),
        started(6.0, 1.0, source="right"),
        started(7.0, 2.0, kind="connected"),
        started(8.0, None),
    ]
    assert find_starts(events, "left") == [
        (ZERO + 5 * NS_PER_S, ZERO - 3 * NS_PER_S),
        (ZERO + 20 * NS_PER_S, ZERO + 19 * NS_PER_S),
    ]
    assert find_starts(events, "right") == [(ZERO + 6 * NS_PER_S, ZERO + NS_PER_S)]
    assert find_starts(events, "middle") == []


def test_the_age_of_a_sample_counts_from_the_start_before_it():
    starts = find_starts([started(5.0, -3.0), started(20.0, 19.0)], "left")
    t = np.array([4.0, 5.0, 19.99, 20.0, 25.0])
    np.testing.assert_allclose(time_since_power_on(t, starts, ZERO), [7.0, 8.0, 22.99, 1.0, 6.0], atol=1e-6)
    # Without a known start the first sample is used.
    np.testing.assert_allclose(time_since_power_on(t, [], ZERO), t - 4.0)
    assert len(time_since_power_on(np.empty(0), [], ZERO)) == 0


@pytest.mark.parametrize("reported", [True, False])
def test_the_summary_lists_applied_effects_and_the_power_on_time(reported):
    t = np.arange(0.0, 30.0, 0.5)
    nodes = {"left": Table({"t": t, **dict.fromkeys(("gx", "gy", "gz", "ax", "ay", "az"), np.zeros(60))})}
    warm = CalibratedEffect({"z": Quantity(0.01, 1e-3), "time_constant": Quantity(60.0, 1.0)})
    calibration = Calibration({"left": NodeCalibration({"gyro_warmup": warm}), "right": NodeCalibration({})})
    events = [started(0.0, -12.5), started(20.0, 18.0)] if reported else []
    output = apply_calibration(nodes, calibration, events=events, t_zero_ns=ZERO)
    assert set(output.summaries) == {"left"}
    assert output.summaries["left"]["applied"] == ["gyro_warmup"]
    power_on = output.summaries["left"]["power_on"]
    assert power_on == (pytest.approx(-12.5) if reported else None)
    age = np.where(t < 20.0, t + 12.5, t - 18.0) if reported else t
    np.testing.assert_allclose(output.nodes["left"]["gz"], -0.01 * (1.0 - np.exp(-age / 60.0)), atol=1e-9)
    assert len(output.warnings) == (not reported)
    assert all("from its first sample" in line for line in output.warnings)
