"""The check of the demo's track against its own sigmas."""

import numpy as np
import pytest

from hubodo.demo.sigma_check import check_sigmas
from hubodo.errors import HubodoError
from hubodo.fuse.track import Track
from hubodo.recording import Table

T = np.linspace(0.0, 10.0, 101)


def _track(error: np.ndarray, sigma: float | np.ndarray) -> Track:
    """Return a straight track at 2 m/s with an error to the left; sigma: m in each direction."""
    zero = np.zeros(len(T))
    return Track(
        T, 5.0 + 2.0 * T, error, zero, sigma_x=zero + sigma, sigma_y=zero + sigma, sigma_heading=zero + 0.01
    )


TRUTH = Table({"t": T, "x": 2.0 * T, "y": 3.0 + 0.0 * T})


def test_errors_are_measured_from_the_start_of_the_track() -> None:
    """Track and truth start 5 m and 3 m apart."""
    check_sigmas(_track(0.0 * T, 0.001), TRUTH, "log.mcap")


def test_the_limit_is_five_sigmas_of_both_directions_and_two_centimetres() -> None:
    limit = 5.0 * np.hypot(0.1, 0.1) + 0.02
    check_sigmas(_track(np.where(T > 7.0, 0.999 * limit, 0.0), 0.1), TRUTH, "log.mcap")
    with pytest.raises(HubodoError) as error:
        check_sigmas(_track(np.where(T > 7.0, 1.001 * limit, 0.0), 0.1), TRUTH, "log.mcap")
    text = str(error.value)
    assert text.startswith(f"the track is {1.001 * limit:.2f} m from the truth at t = 7.1 s")
    assert text.endswith("see hubodo info log.mcap")


def test_the_error_that_exceeds_its_sigma_most_is_reported_and_not_the_largest_one() -> None:
    error = np.where(T > 7.0, 3.0, np.where(T > 2.0, 0.5, 0.0))
    sigma = np.where(T > 7.0, 1.0, 0.01)
    with pytest.raises(HubodoError, match=r"is 0\.50 m from the truth at t = 2\.1 s"):
        check_sigmas(_track(error, sigma), TRUTH, "log.mcap")


def test_poses_outside_the_time_of_the_truth_are_not_compared() -> None:
    truth = Table({"t": T[:50], "x": 2.0 * T[:50], "y": 0.0 * T[:50]})
    check_sigmas(_track(np.where(T > 5.0, 9.0, 0.0), 0.001), truth, "log.mcap")
    check_sigmas(_track(9.0 * T, 0.001), Table({"t": T + 50.0, "x": T, "y": T}), "log.mcap")
