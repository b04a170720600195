"""Nodes on a bench: a turntable with stops, and a node that is carried from pose to pose."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hubodo.earth import EARTH_RATE, STANDARD_GRAVITY
from hubodo.model.bench import PoseSequence, TurntableProgramme, quintic_step
from hubodo.model.inputs import EarthRotation

ANGLES, STOP, TURN = (0.7, 2.0, -1.0), 4.0, 2.0


def wanted_angle(t):
    """Each turn is the quintic with zero rate and acceleration at its ends."""
    number, into = divmod(t, STOP + TURN)
    start_angle, end = (ANGLES[int(number + k) % len(ANGLES)] for k in (0, 1))
    s = max(into - STOP, 0.0) / TURN
    return start_angle + (end - start_angle) * (10.0 * s**3 - 15.0 * s**4 + 6.0 * s**5)


def test_a_table_repeats_its_stops_and_records_its_angle():
    earth = EarthRotation(0.8, 0.3)
    inputs, table = TurntableProgramme(ANGLES, STOP, TURN).inputs_and_record(25.0, earth)
    t, angle, moving = table.T
    assert t == pytest.approx(np.arange(250) / 10.0)
    assert angle == pytest.approx([wanted_angle(x) for x in t], abs=1e-6)
    tenths = np.arange(250) % 60
    assert moving.tolist() == [float(tenth >= 40) for tenth in tenths]
    assert inputs.earth is earth
    assert not inputs.speed(t).any()
    fine = np.linspace(0.5, 24.5, 97)
    rate = [(wanted_angle(x + 1e-5) - wanted_angle(x - 1e-5)) / 2e-5 for x in fine]
    assert inputs.yaw_rate(fine) == pytest.approx(rate, abs=1e-5)
    assert inputs.yaw_rate.end == 25.0


def test_a_short_record_of_a_table_is_possible():
    inputs, table = TurntableProgramme(ANGLES, STOP, TURN).inputs_and_record(0.03)
    assert table.tolist() == [[0.0, 0.7, 0.0]]
    assert inputs.earth is None and not inputs.yaw_rate(np.array([0.0, 0.03])).any()


REST, ROUND, LATITUDE = 3.0, 1.5, 0.8
POSES = Rotation.random(4, rng=np.random.default_rng(17))
T = np.linspace(0.0, 4 * (REST + ROUND) + 2.0, 12001)


@pytest.fixture(scope="module")
def carried():
    """Return (without, with the rotation of the Earth): rate, slope and force at T."""
    return [PoseSequence(POSES, REST, ROUND, latitude)(T) for latitude in (None, LATITUDE)]


def resting(margin=0.0):
    """Return the pose at T, -1 during a turn; the last pose is held."""
    into = T % (REST + ROUND)
    number = np.minimum(T // (REST + ROUND), 3).astype(int)
    return np.where((into < REST - margin) & (into > margin) | (number == 3), number, -1)


def test_the_duration_is_that_of_all_poses_and_of_the_turns_between():
    assert PoseSequence(POSES, REST, ROUND).duration == 4 * REST + 3 * ROUND


@pytest.mark.parametrize("earth", [0, 1])
def test_at_standstill_a_node_measures_gravity_and_earth_rate_in_the_axes_of_its_pose(carried, earth):
    rate, slope, force = carried[earth]
    turning = earth * EARTH_RATE * np.array([0.0, np.cos(LATITUDE), np.sin(LATITUDE)])
    for number, pose in enumerate(POSES):
        still = resting() == number
        assert still.sum() > 1500
        for motions, world in ((rate, turning), (force, [0.0, 0.0, STANDARD_GRAVITY]), (slope, np.zeros(3))):
            expected = pose.inv().apply(world)
            assert np.abs(motions[:, still] - expected[:, None]).max() < 1e-9


def test_rate_and_force_during_a_turn_are_consistent(carried):
    """A world-fixed vector f rotates against the rate w, f' = -w x f; the rate integrates its derivative."""
    step = T[1] - T[0]
    (rate, slope, force), (with_earth, with_slope, same) = carried
    moving = np.abs(rate).max(axis=0) > 0.0
    assert (resting() == -1)[moving].all()
    turned = np.gradient(force, step, axis=1) + np.cross(rate, force, axis=0)
    assert np.abs(turned).max() < 2e-3
    for of, its in ((rate, slope), (with_earth, with_slope)):
        gained = np.cumsum(0.5 * step * (its[:, 1:] + its[:, :-1]), axis=1)
        assert np.abs(of[:, 1:] - of[:, :1] - gained).max() < 1e-4 < 1e-3 * np.abs(of).max()
    # The Earth rate rotates with gravity, with a slope too small to be visible beside the others.
    earth, own = with_earth - rate, with_slope - slope
    assert np.array_equal(same, force)
    assert np.linalg.norm(earth, axis=0) == pytest.approx(EARTH_RATE)
    assert np.sum(earth * force, axis=0) == pytest.approx(EARTH_RATE * STANDARD_GRAVITY * np.sin(LATITUDE))
    assert own == pytest.approx(-np.cross(rate, earth, axis=0), abs=1e-12)


def test_a_turn_is_about_one_axis_by_the_smallest_angle(carried):
    rate, *_ = carried[0]
    for number in range(3):
        start_angle = number * (REST + ROUND) + REST
        turn = (start_angle <= T) & (start_angle + ROUND >= T)
        whole = np.sum(rate[:, turn], axis=1) * (T[1] - T[0])
        assert whole == pytest.approx((POSES[number].inv() * POSES[number + 1]).as_rotvec(), abs=1e-4)


def test_the_smooth_step_has_the_returned_derivatives():
    """Compared with finite differences; constant at both ends and beyond them."""
    share = np.linspace(-0.2, 1.2, 1401)
    value, first, second = quintic_step(share)
    np.testing.assert_allclose(np.gradient(value, share)[2:-2], first[2:-2], atol=1e-5)
    np.testing.assert_allclose(np.gradient(first, share)[2:-2], second[2:-2], atol=0.07)
    inner = (share > 0.01) & (share < 0.99)
    np.testing.assert_allclose(np.gradient(first, share)[inner], second[inner], atol=1e-4)
    assert value[0] == 0.0
    assert value[-1] == 1.0
    assert not first[[0, -1]].any()
