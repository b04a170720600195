"""Effects of vehicle and road on the geometry, by hand."""

import pytest

from hubodo.effects import Geometry
from hubodo.effects.vehicle import RoadGrade, TrackWidth


def test_track_width_is_relative_and_grades_add_up():
    geometry = TrackWidth(0.1).adjust_geometry(Geometry("left", 0.3, 0.9))
    geometry = RoadGrade(0.02).adjust_geometry(RoadGrade(0.01).adjust_geometry(geometry))
    assert geometry.track_width == pytest.approx(0.99)
    assert geometry.grade == pytest.approx(0.03)


def test_a_grade_prior_is_a_stationary_process():
    """Gauss-Markov: random walk = sigma √(2 / T)."""
    prior = RoadGrade.odometry_prior("angle")
    assert prior.random_walk == pytest.approx(prior.sigma * (2.0 / prior.correlation_time) ** 0.5)
