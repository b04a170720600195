"""Faulty fixes in a batch: jumps, overconfident sigmas, outliers and clock offsets."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from graph_drives import drive_fixes, odometry_path, position_rms, shift_north, simulate_drive, track_errors
from hubodo.errors import InputError
from hubodo.fuse.graph.batch import fuse_graph
from hubodo.fuse.graph.fixes import estimate_scatter, find_consistent_fixes
from hubodo.fuse.graph.review import estimate_sigma_growth


@pytest.mark.parametrize(
    ("start", "end"),
    [(80.0, 90.0), (80.0, 80.2), (-1.0, 10.0), (130.0, 1e9)],
    ids=["10 s", "once", "start", "to end"],
)
def test_fixes_that_jump_by_a_hundred_metres_are_rejected_and_reported(start, end):
    drive = simulate_drive(7)
    jumped = (drive.fix_t > start) & (drive.fix_t < end)
    result = fuse_graph(odometry_path(drive), shift_north(drive_fixes(drive), jumped, 100.0))
    error = track_errors(drive, result)
    assert position_rms(error) < 1.5
    messages = [text for text in result.warnings if "jumped" in text]
    assert len(messages) == 1
    assert f"t = {drive.fix_t[jumped][0]:.1f}" in messages[0]


def test_a_jump_too_small_to_be_rejected_inflates_the_sigmas():
    drive = simulate_drive(8)
    without_jump = fuse_graph(odometry_path(drive), drive_fixes(drive))
    result = fuse_graph(
        odometry_path(drive), shift_north(drive_fixes(drive), (drive.fix_t > 80) & (drive.fix_t < 100), 20.0)
    )
    assert result.track.sigma_x.mean() > 2.0 * without_jump.track.sigma_x.mean()
    assert any("correlated" in text for text in result.warnings)


@pytest.mark.parametrize("repeats", [1, 2, 3])
def test_sigmas_grow_by_the_root_of_the_number_of_equal_fixes(repeats):
    """The mean of values repeated k times has the variance of the mean of the distinct values."""
    rng = np.random.default_rng(3)
    errors = 0.8 * np.repeat(rng.standard_normal((6000 // repeats, 2)), repeats, axis=0)
    item = SimpleNamespace(residual=errors, squared_norms=np.zeros(len(errors)))
    loss = SimpleNamespace(weight=np.ones_like)
    factors = SimpleNamespace(linearise=lambda poses, constants: item, loss=loss)
    growth, reasons = estimate_sigma_growth(
        SimpleNamespace(find_group=lambda kind: factors), SimpleNamespace(poses=None, constants=None), 1.0
    )
    assert growth == pytest.approx(repeats**0.5, rel=0.03)
    assert len(reasons) == (repeats > 1) and all(f"{repeats} count as one" in text for text in reasons)


def test_overconfident_sigmas_of_a_receiver_are_inflated():
    drive = simulate_drive(9)
    consistent = fuse_graph(odometry_path(drive), drive_fixes(drive, sigma=5.0))
    overconfident = fuse_graph(odometry_path(drive), drive_fixes(drive, sigma=0.5))
    assert any("scatter" in text for text in overconfident.warnings)
    assert overconfident.track.sigma_x.mean() == pytest.approx(consistent.track.sigma_x.mean(), rel=0.2)
    assert position_rms(track_errors(drive, overconfident)) < 1.0


@pytest.mark.parametrize("delay", [2.0, -1.5])
def test_a_clock_offset_is_estimated_corrected_and_reported(delay):
    drive = simulate_drive(10, delay=delay)
    result = fuse_graph(odometry_path(drive), drive_fixes(drive))
    estimate = result.constants["gnss_delay"]
    assert abs(estimate.value - delay) < 4.0 * estimate.sigma
    assert position_rms(track_errors(drive, result)) < 1.0
    assert any("time stamps" in text for text in result.warnings)


def test_fixes_without_a_clock_offset_are_not_shifted():
    drive = simulate_drive(11, sigma=0.05)
    result = fuse_graph(odometry_path(drive), drive_fixes(drive, sigma=0.05))
    assert abs(result.constants["gnss_delay"].value) < 4.0 * result.constants["gnss_delay"].sigma
    assert result.warnings == ()


def test_fixes_with_invalid_latitude_are_reported_and_dropped():
    drive = simulate_drive(14)
    fixes = drive_fixes(drive)
    latitude = fixes.latitude_deg.copy()
    latitude[16:20] = 95.0
    result = fuse_graph(odometry_path(drive), replace(fixes, latitude_deg=latitude))
    assert position_rms(track_errors(drive, result)) < 1.0
    (text,) = result.warnings
    assert "4 of" in text
    assert "row 17" in text
    with pytest.raises(InputError, match=r"no usable fix.*not on Earth"):
        fuse_graph(odometry_path(drive), replace(fixes, latitude_deg=fixes.latitude_deg * 0.0 + 95.0))


def test_fixes_of_another_clock_raise_one_clear_error():
    drive = simulate_drive(15, length=40.0)
    fixes = drive_fixes(drive)
    with pytest.raises(InputError, match="clocks differ"):
        fuse_graph(odometry_path(drive), replace(fixes, t=fixes.t + 1e6))


def test_fixes_at_null_island_do_not_move_the_frame():
    drive = simulate_drive(16)
    fixes, at_null_island = drive_fixes(drive), drive.fix_t < 15.0
    result = fuse_graph(
        odometry_path(drive),
        replace(
            fixes,
            latitude_deg=np.where(at_null_island, 0.0, fixes.latitude_deg),
            longitude_deg=np.where(at_null_island, 0.0, fixes.longitude_deg),
        ),
    )
    assert position_rms(track_errors(drive, result)) < 1.0
    assert any("km from the others" in text for text in result.warnings)


def test_screening_keeps_fixes_consistent_with_the_distance_rolled():
    distance = np.arange(100.0)
    position = distance + 0j
    sigma = np.ones(100)
    assert find_consistent_fixes(position, distance, sigma).all()
    jumped = position + np.where((distance > 20) & (distance < 30), 100j, 0)
    assert np.array_equal(
        find_consistent_fixes(jumped, distance, sigma), ~((distance > 20) & (distance < 30))
    )
    rng = np.random.default_rng(0)
    noise = rng.standard_normal(100) + 1j * rng.standard_normal(100)
    assert estimate_scatter(0.01 * position + noise, 0.01 * distance, sigma) == 1.0
    assert estimate_scatter(0.01 * position + 3.0 * noise, 0.01 * distance, sigma) == pytest.approx(
        3.0, rel=0.2
    )
