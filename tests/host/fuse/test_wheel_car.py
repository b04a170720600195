"""A real car that no simulation knows: what one drive teaches makes the others better."""

import pytest

import wanted
from accuracy import car
from hubodo.errors import CalibrationError


@pytest.fixture(scope="module")
def logs():
    wanted.recording("car")
    return car.drives()


@pytest.mark.parametrize("first", ["drive-1", "drive-3"])
def test_one_wheel_calibrated_on_a_drive_is_better_than_a_tape_measure_on_others(logs, first):
    """A tape measure gives 0.5 to 0.8 % of the way at most from the truth."""
    calibration = car.calibration_from(logs[first], ("right",))
    for name in set(logs) - {first}:
        tape = car.largest_percent(logs[name], ("right",), None)
        found = car.largest_percent(logs[name], ("right",), calibration)
        print(f"{first} to {name}: {tape:.2f} % by tape measure, {found:.2f} % calibrated")
        assert found < 0.5 and found < 0.6 * tape


def test_two_wheels_are_calibrated_or_left_as_they_are(logs):
    """The truth of drive-2 jumps and wanders by what a tape measure is off: nothing is gained from it."""
    calibration = car.calibration_from(logs["drive-1"], ("left", "right"))
    assert car.largest_percent(logs["drive-2"], ("left", "right"), calibration) < 0.4
    with pytest.raises(CalibrationError, match="no better"):
        car.calibration_from(logs["drive-2"], ("left", "right"))
