"""Events of power-on, of the last health report and of the clock."""

from fakes.node_messages import health
from hubodo.ingest.node.clock import ClockEstimate
from hubodo.ingest.node.life_events import final_clock_event, final_health_event, power_on_event
from hubodo.units import NS_PER_S


def test_the_age_of_a_node_is_that_of_its_first_sample_modulo_a_turn_of_its_ticks() -> None:
    event = power_on_event("left", 4711, 2 * NS_PER_S, 14 * NS_PER_S + NS_PER_S // 2)
    assert (event.t_ns, event.kind, event.source) == (14_500_000_000, "started", "left")
    assert event.data["age"] == 12.5
    assert event.data["power_on_ns"] == 2_000_000_000
    # Ticks of MicroPython turn over after 2^30 us.
    assert event.data["age_modulo"] == 1073.741824
    assert "12.5 s before this sample" in event.text


def test_the_last_report_has_all_its_counters() -> None:
    event = final_health_event("right", health(frames_damaged=8), 5)
    assert (event.t_ns, event.kind, event.source) == (5, "health", "right")
    assert event.data["frames_damaged"] == 8


def test_the_clock_is_reported_in_ppm_and_milliseconds() -> None:
    estimate = ClockEstimate(1_500_000_000, 12.34e-6, 0.5e-6, True, 250_000.0, "two way", 40, 1)
    event = final_clock_event("left", estimate, 9)
    assert event.text == "left: clock two way, drift +12.3 ppm, 1 sigma 0.250 ms"
    assert event.data["offset"] == 1.5
    assert abs(event.data["drift_ppm"] - 12.34) < 1e-9
    assert abs(event.data["sigma"] - 0.25e-3) < 1e-12
    assert (event.data["exchanges"], event.data["resets"]) == (40, 1)
