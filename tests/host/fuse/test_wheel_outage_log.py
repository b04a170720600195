"""Log of outages: what is listed, and how a vehicle shows that it was stationary across one."""

from __future__ import annotations

import cmath
from types import SimpleNamespace
from typing import Any

import pytest

from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.outage_log import OutageLog

FORCES_BEFORE = [9.8 + 0j, 9.8j]
HEADING_VARIANCE = 0.5


def wheel_windows(*forces: complex) -> Any:
    """Return wheels whose standstill detectors have these mean specific forces."""
    return tuple((SimpleNamespace(standstill=SimpleNamespace(force=force)), None) for force in forces)


def check_after_outage(
    *forces: complex, before: list[complex] | None = FORCES_BEFORE, waiting_windows: int = 0
) -> tuple[OutageLog, float]:
    """Return the log and the heading variance after standstill resumes `waiting_windows` after an outage."""
    outages, variance = OutageLog(), 2.0
    outages.add_outage(10.0, 25.5, HEADING_VARIANCE, before)
    for _ in range(waiting_windows):
        if outages.may_have_been_stationary:
            variance += outages.check_standstill(wheel_windows(*forces), MotionState.MOVING)
    if outages.may_have_been_stationary:
        variance += outages.check_standstill(wheel_windows(*forces), MotionState.STANDSTILL)
    assert not outages.may_have_been_stationary
    return outages, variance


STATIONARY_VARIANCE = 2.0 + 0.01**2 - HEADING_VARIANCE
"""Heading variance of a stationary vehicle: that of the outage is replaced by (0.01 rad)²."""


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_unchanged_gravity_direction_in_the_wheels_keeps_the_heading(sign: float) -> None:
    for angle, stationary in ((0.09, True), (0.11, False)):
        for angles in ((angle, 0.0), (0.0, angle), (angle, angle)):
            forces = [
                force * cmath.exp(1j * sign * turn) for force, turn in zip(FORCES_BEFORE, angles, strict=True)
            ]
            outages, variance = check_after_outage(*forces)
            assert variance == pytest.approx(STATIONARY_VARIANCE if stationary else 2.0)
            assert [outage.was_stationary for outage in outages.listed_outages] == [stationary]


def test_wheels_not_received_at_standstill_are_ignored() -> None:
    assert check_after_outage(FORCES_BEFORE[0], 0j)[1] == pytest.approx(STATIONARY_VARIANCE)
    assert check_after_outage(FORCES_BEFORE[0], 5.0 + 0j, before=[FORCES_BEFORE[0], 0j])[1] == pytest.approx(
        STATIONARY_VARIANCE
    )
    assert check_after_outage(0j, 0j)[1] == 2.0
    assert check_after_outage(*FORCES_BEFORE, before=None)[1] == 2.0


def test_standstill_must_be_confirmed_within_two_seconds() -> None:
    assert check_after_outage(*FORCES_BEFORE, waiting_windows=19)[1] == pytest.approx(STATIONARY_VARIANCE)
    assert check_after_outage(*FORCES_BEFORE, waiting_windows=20)[1] == 2.0


def test_all_outages_are_counted_and_the_first_hundred_listed() -> None:
    outages = OutageLog()
    for number in range(102):
        outages.add_outage(10.0 * number, 10.0 * number + 2.5, HEADING_VARIANCE, FORCES_BEFORE)
    assert (outages.count, outages.windows, len(outages.listed_outages)) == (102, 102 * 25, 100)
    outages.check_standstill(wheel_windows(*FORCES_BEFORE), MotionState.STANDSTILL)
    # That concerns the last outage, which is not listed.
    assert not any(outage.was_stationary for outage in outages.listed_outages)
    lines = outages.list_warnings("left and right")
    assert len(lines) == 101 and lines[-1] == "left and right: not heard 2 more times"
    assert "from t = 0.0 to 2.5 s (2.5 s)" in lines[0] and "where it went is not known" in lines[0]
    stationary, _ = check_after_outage(*FORCES_BEFORE)
    assert (
        "its heading is kept" in stationary.list_warnings("left")[0]
        and len(stationary.list_warnings("left")) == 1
    )
