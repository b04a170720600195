"""GNSS outages of a track with known errors."""

from dataclasses import fields

import numpy as np
import pytest

from hubodo.fuse.track import Track, find_gnss_outages

T = np.arange(0.0, 100.5, 0.5)
ZEROS = np.zeros(len(T))


def straight(speed=2.0):
    """Return a track along x with position sigmas 0.3 t and 0.4 t."""
    return Track(T, speed * T, ZEROS, ZEROS, np.full(len(T), speed), 0.3 * T, 0.4 * T, ZEROS)


FIXES = np.concatenate([np.arange(0.0, 21.0), np.arange(40.0, 61.0), [70.0], np.arange(80.5, 101.0)])
"""Fixes are missing from 20 to 40 s and from 70 to 80.5 s; ten seconds are no outage."""


def test_an_outage_is_more_than_ten_seconds_without_a_fix():
    assert [(gap.start, gap.end) for gap in find_gnss_outages(straight(), FIXES)] == [
        (20.0, 40.0),
        (70.0, 80.5),
    ]
    assert [gap.start for gap in find_gnss_outages(straight(), FIXES, min_duration=10.5)] == [20.0]
    assert len(find_gnss_outages(straight(), FIXES, min_duration=0.9)) > 2
    assert find_gnss_outages(straight(), FIXES[:1]) == ()


def test_without_truth_an_outage_has_a_distance_and_a_sigma():
    first, second = find_gnss_outages(straight(), FIXES)
    assert first.distance == pytest.approx(40.0) and second.distance == pytest.approx(21.0)
    assert first.sigma == pytest.approx(0.5 * 40.0) and second.sigma == pytest.approx(0.5 * 80.5)
    assert first.error is first.percent is first.worst is None


def lateral_error():
    """Return the error to the left, m: up to 5 and back to 3 in the first outage, up to 1 in the second."""
    first = np.interp(T, [20.0, 30.0, 40.0], [0.0, 5.0, 3.0])
    return np.where((T > 20.0) & (T <= 40.0), first, 0.0) + np.where(
        (T > 70.0) & (T <= 80.5), np.clip((T - 70.0) / 10.0, 0.0, 1.0), 0.0
    )


def test_truth_is_aligned_while_there_are_fixes_and_the_rest_is_the_error():
    truth = (T, 2.0 * T + 700.0, lateral_error() - 300.0)
    first, second = find_gnss_outages(straight(), FIXES, truth)
    # Fixes ten seconds apart cover the time between them, which is no outage.
    assert (first.error, first.worst) == (pytest.approx(3.0), pytest.approx(5.0))
    assert first.percent == pytest.approx(100.0 * 3.0 / 40.0)
    assert (second.error, second.worst) == (pytest.approx(1.0), pytest.approx(1.0))


def test_truth_that_ends_early_is_not_extrapolated():
    """The truth covers the first outage, and then only the second one."""
    early = T <= 60.0
    truth = (T[early], 2.0 * T[early] + 700.0, lateral_error()[early])
    first, _ = find_gnss_outages(straight(), FIXES, truth)
    assert (first.error, first.worst) == (pytest.approx(3.0), pytest.approx(5.0))
    late = T >= 50.0
    truth = (T[late], 2.0 * T[late] + 700.0, lateral_error()[late])
    *_, second = find_gnss_outages(straight(), FIXES, truth)
    assert second.error == pytest.approx(1.0)


def test_without_fixes_the_truth_is_aligned_over_its_whole_duration():
    truth = (T, 2.0 * T + 700.0, ZEROS + 4.0)
    (outage,) = find_gnss_outages(straight(), np.array([0.0, 100.0]), truth)
    assert outage.error == pytest.approx(0.0) and outage.worst == pytest.approx(0.0)
    (without_common_time,) = find_gnss_outages(straight(), np.array([0.0, 100.0]), (T + 1e6, 2.0 * T, ZEROS))
    assert without_common_time.error == pytest.approx(200.0)


def test_a_standstill_has_no_percentage_and_a_gap_without_poses_no_outage():
    (outage, _) = find_gnss_outages(straight(0.0), FIXES, (T, ZEROS, ZEROS))
    assert outage.distance == 0.0 and outage.error == 0.0 and outage.percent is None
    coarse = Track(*(getattr(straight(), field.name)[::50] for field in fields(Track)))
    assert find_gnss_outages(coarse, FIXES) == ()
