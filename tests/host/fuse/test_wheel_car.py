"""A real car that no simulation knows: what one drive teaches makes the others better."""

from functools import cache

import pytest

import wanted
from accuracy import car
from hubodo.fuse.wheel.calibration.held_out import ErrorSummary, HeldOutErrors


@pytest.fixture(scope="module")
def logs():
    wanted.recording("car")
    return car.drives()


@pytest.fixture(scope="module")
def tape(logs):
    """Largest distance, %, by a tape measure, of a drive with some of its nodes: asked for more than once."""
    return cache(lambda name, nodes: car.largest_percent(logs[name], nodes, None))


def _leave_nothing_out(monkeypatch):
    """Other drives judge: no stretches of this one need to, which takes most of the time."""
    nothing = HeldOutErrors(ErrorSummary(0.0, 0.0), ErrorSummary(0.0, 0.0), 0)
    monkeypatch.setattr("hubodo.fuse.wheel.calibration.calibrate.measure_held_out_errors", lambda *_: nothing)


@pytest.mark.parametrize("first", ["drive-1", "drive-3"])
def test_one_wheel_calibrated_on_a_drive_is_better_than_a_tape_measure_on_others(
    logs, tape, first, monkeypatch
):
    """A tape measure gives 0.5 to 0.8 % of the way at most from the truth."""
    _leave_nothing_out(monkeypatch)
    calibration = car.calibration_from(logs[first], ("right",))
    for name in set(logs) - {first}:
        before = tape(name, ("right",))
        found = car.largest_percent(logs[name], ("right",), calibration)
        print(f"{first} to {name}: {before:.2f} % by tape measure, {found:.2f} % calibrated")
        assert found < 0.5 and found < 0.6 * before


@pytest.mark.parametrize(("first", "other"), [("drive-1", "drive-2"), ("drive-2", "drive-1")])
def test_two_wheels_calibrated_on_a_drive_are_better_than_a_tape_measure_on_the_other(
    logs, tape, first, other, monkeypatch
):
    """Though the truth of drive-2 jumps, and wanders by what a tape measure is off.

    Stretches of drive-1 that are left out do not say otherwise.
    """
    if first == "drive-2":
        _leave_nothing_out(monkeypatch)
    calibration = car.calibration_from(logs[first], ("left", "right"))
    found = car.largest_percent(logs[other], ("left", "right"), calibration)
    assert found < 0.4
    assert found < 0.8 * tape(other, ("left", "right"))
