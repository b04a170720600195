"""What is told of times in which no wheel was heard, and how a vehicle shows that it was not moved."""

from __future__ import annotations

import cmath
from types import SimpleNamespace
from typing import Any

import pytest

from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.outage_log import OutageLog

BEFORE = [9.8 + 0j, 9.8j]
TURNED = 0.5


def pairs(*forces: complex) -> Any:
    return tuple((SimpleNamespace(standstill=SimpleNamespace(force=force)), None) for force in forces)


def looked(*forces: complex, before: list[complex] | None = BEFORE, wait: int = 0) -> tuple[OutageLog, float]:
    """Silences of a vehicle that rests again after so many windows, and what its heading's variance is."""
    made, variance = OutageLog(), 2.0
    made.add_outage(10.0, 25.5, TURNED, before)
    for _ in range(wait):
        if made.may_have_been_stationary:
            variance += made.check_standstill(pairs(*forces), MotionState.MOVING)
    if made.may_have_been_stationary:
        variance += made.check_standstill(pairs(*forces), MotionState.STANDSTILL)
    assert not made.may_have_been_stationary
    return made, variance


KEPT = 2.0 + 0.01**2 - TURNED
"""What is left of the variance of a heading that was kept: a hundredth of a radian of nudging."""


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_vehicle_in_whose_wheels_gravity_lies_as_before_was_not_turned(sign: float) -> None:
    for off, kept in ((0.09, True), (0.11, False)):
        for places in ((off, 0.0), (0.0, off), (off, off)):
            forces = [was * cmath.exp(1j * sign * by) for was, by in zip(BEFORE, places, strict=True)]
            made, variance = looked(*forces)
            assert variance == pytest.approx(KEPT if kept else 2.0)
            assert [silence.was_stationary for silence in made.listed] == [kept]


def test_a_wheel_that_was_not_heard_at_rest_has_no_say_and_two_such_say_nothing() -> None:
    assert looked(BEFORE[0], 0j)[1] == pytest.approx(KEPT)
    assert looked(BEFORE[0], 5.0 + 0j, before=[BEFORE[0], 0j])[1] == pytest.approx(KEPT)
    assert looked(0j, 0j)[1] == 2.0
    assert looked(*BEFORE, before=None)[1] == 2.0


def test_it_has_two_seconds_to_show_it() -> None:
    assert looked(*BEFORE, wait=19)[1] == pytest.approx(KEPT)
    assert looked(*BEFORE, wait=20)[1] == 2.0


def test_silences_are_counted_and_a_hundred_of_them_told() -> None:
    made = OutageLog()
    for number in range(102):
        made.add_outage(10.0 * number, 10.0 * number + 2.5, TURNED, BEFORE)
    assert (made.count, made.windows, len(made.listed)) == (102, 102 * 25, 100)
    made.check_standstill(pairs(*BEFORE), MotionState.STANDSTILL)
    # That was the last of all, which is not told.
    assert not any(silence.was_stationary for silence in made.listed)
    lines = made.list_warnings("left and right")
    assert len(lines) == 101 and lines[-1] == "left and right: not heard 2 more times"
    assert "from t = 0.0 to 2.5 s (2.5 s)" in lines[0] and "where it went is not known" in lines[0]
    kept, _ = looked(*BEFORE)
    assert "its heading is kept" in kept.list_warnings("left")[0] and len(kept.list_warnings("left")) == 1
