"""Causes of gaps from the events of a log."""

from hubodo.log.gap_causes import explain_gap, last_health_reports, sum_losses
from hubodo.recording import Event

S = 1_000_000_000


def gap(t, duration, cause, node="left", **data):
    return Event(t * S, "gap", node, cause, {"node": node, "duration_s": duration, "cause": cause, **data})


def test_a_gap_is_explained_by_the_event_of_its_node_that_overlaps_most():
    events = [
        gap(1, 1.0, "radio"),
        gap(2, 5.0, "reset"),
        gap(2, 9.0, "other node", node="right"),
        gap(2, 8.0, "magnetometer only", stream="Mag"),
    ]
    assert explain_gap("/left/imu", 1 * S, 6 * S, events) == "reset"
    assert explain_gap("/left/imu", 20 * S, 21 * S, events) == "not explained by any event"
    assert explain_gap("/left/mag", 2 * S, 9 * S, events) == "magnetometer only"
    events.append(gap(2, 7.0, "second accelerometer only", stream="HighG"))
    high_g = "/hubodo/columns/high_g/left"
    assert explain_gap(high_g, 2 * S, 9 * S, events) == "second accelerometer only"
    assert explain_gap("/left/imu", 2 * S, 9 * S, events) == "reset"


def test_losses_are_summed_by_node_and_cause_and_unknown_counts_counted():
    events = [
        gap(1, 0.5, "radio", samples_lost=3, frames_lost=1),
        gap(5, 0.5, "radio", samples_lost=4, frames_lost=2),
        gap(9, 2.0, "reset", samples_lost=None),
    ]
    radio, reset = sum_losses(events)
    assert (radio.cause, radio.gaps, radio.samples, radio.frames, radio.duration) == ("radio", 2, 7, 3, 1.0)
    assert (reset.samples, reset.unknown) == (0, 1)


def test_the_last_health_report_of_each_node_counts():
    events = [Event(t, "health", "left", "", {"node": "left", "t": t}) for t in (1, 2)]
    assert last_health_reports(events)["left"]["t"] == 2
