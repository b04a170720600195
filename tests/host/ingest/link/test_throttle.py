"""The throttle of recurring events."""

from hubodo.ingest.link.throttle import EventThrottle
from hubodo.units import NS_PER_S


def test_intervals_double_from_ten_seconds_and_withheld_events_are_counted():
    throttle = EventThrottle()
    admitted = {t: throttle.admit(t * NS_PER_S) for t in range(75)}
    assert {t: count for t, count in admitted.items() if count is not None} == {0: 0, 10: 9, 30: 19, 70: 39}


def test_an_interval_without_events_and_a_reset_admit_at_once():
    throttle = EventThrottle()
    assert throttle.admit(0) == 0 and throttle.admit(NS_PER_S) is None
    assert throttle.admit(25 * NS_PER_S) == 1
    assert throttle.admit(26 * NS_PER_S) is None
    throttle.reset()
    assert throttle.admit(27 * NS_PER_S) == 1
