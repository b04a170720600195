"""The wheel filter on logs of a real car: calibration on one drive improves the others.

`make road` prints each drive calibrated on each other one.
"""

from functools import cache

import pytest

import wanted
from accuracy import car
from wheel_runs import skip_held_out_segments


@pytest.fixture(scope="module")
def logs():
    wanted.recording("car")
    return car.drives()


@pytest.fixture(scope="module")
def uncalibrated_error(logs):
    """Return a cached function for the largest distance error, %, of a drive with tape-measured sizes."""
    return cache(lambda name, nodes: car.largest_percent(logs[name], nodes, None))


def test_one_wheel_calibrated_on_one_drive_beats_tape_measured_sizes_on_others(
    logs, uncalibrated_error, monkeypatch
):
    """Tape-measured sizes give a largest error of 0.5 to 0.8 % of the distance."""
    skip_held_out_segments(monkeypatch)
    first = "drive-1"
    calibration = car.calibration_from(logs[first], ("right",))
    for name in set(logs) - {first}:
        before = uncalibrated_error(name, ("right",))
        after = car.largest_percent(logs[name], ("right",), calibration)
        print(f"{first} to {name}: {before:.2f} % by tape measure, {after:.2f} % calibrated")
        assert after < 0.5 and after < 0.6 * before


@pytest.mark.repeat
def test_two_wheels_calibrated_on_one_drive_beat_tape_measured_sizes_on_the_other(logs, uncalibrated_error):
    """The held-out segments of drive-1 confirm its calibration as well."""
    calibration = car.calibration_from(logs["drive-1"], ("left", "right"))
    after = car.largest_percent(logs["drive-2"], ("left", "right"), calibration)
    assert after < 0.4
    assert after < 0.8 * uncalibrated_error("drive-2", ("left", "right"))
