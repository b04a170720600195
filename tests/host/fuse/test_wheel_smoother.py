"""Smoothing, with a lag and of the whole log, beside the joint distribution of all states."""

from __future__ import annotations

import numpy as np
import pytest

from hubodo.fuse.wheel.fixed_lag import FixedLagSmoother
from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.records import Pose, SmoothingTerms
from hubodo.fuse.wheel.smoother import smoothed_pose, step_back

SIZE, STEPS = 7, 6
PLACES = [1, 0, 2, 4, 6]


class Chain:
    """States that go on linearly, one measurement of them in each step, filtered as the wheel filter does.

    In step 2 state 3 is begun anew; in step 3 state 5 is made of others before the measurement; before step 4
    lies a time in which all change.
    """

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)

        def near_one() -> np.ndarray:
            return np.eye(SIZE) + 0.2 * rng.standard_normal((SIZE, SIZE))

        self.f = [near_one() for _ in range(STEPS)]
        self.passed = near_one()
        self.by = rng.standard_normal(SIZE)
        self.h = rng.standard_normal((STEPS, SIZE))
        self.z = rng.standard_normal(STEPS)
        self.noise = []
        for _ in range(STEPS):
            root = 0.3 * rng.standard_normal((SIZE, SIZE))
            self.noise.append(root @ root.T)
        self.shortened = [np.diag(rng.uniform(0.1, 0.2, 2)) for _ in range(STEPS)]

    def into(self, step: int) -> np.ndarray:
        """Derivatives of the states before a step's measurement by those after that of the step before."""
        whole = self.f[step - 1]
        if step == 2:
            whole = whole.copy()
            whole[3] = 0.0
        if step == 3:
            whole = whole.copy()
            whole[5] = self.by @ self.f[2]
        return self.passed @ whole if step == 4 else whole

    def filtered(self) -> list[tuple[Pose, SmoothingTerms]]:
        x, p, made = np.zeros(SIZE), np.eye(SIZE), []
        for step in range(STEPS):
            if step:
                f = self.into(step)
                x, p = f @ x, f @ p @ f.T + self.noise[step]
            before = x.tolist(), p.copy()
            h = self.h[step]
            gain = p @ h / (h @ p @ h + 0.5)
            x, p = x + gain * (self.z[step] - h @ x), p - np.outer(gain, h @ p)
            terms = SmoothingTerms(
                *before,
                x.tolist(),
                p.copy(),
                [3] if step == 2 else [],
                self.f[step],
                self.shortened[step],
                (5, self.by) if step == 3 else None,
                self.passed if step == 4 else None,
            )
            pose = Pose(0.1 * step, *(self.f[step] @ x)[PLACES], np.zeros((5, 5)), MotionState.MOVING, 1.0, 2)
            made.append((pose, terms))
        return made

    def joint(self, upto: int) -> tuple[np.ndarray, np.ndarray]:
        """Mean and covariance of the states of all steps, of what was measured up to one of them."""
        size = SIZE * STEPS
        information, right = np.zeros((size, size)), np.zeros(size)
        information[:SIZE, :SIZE] = np.eye(SIZE)
        for step in range(STEPS):
            own = slice(SIZE * step, SIZE * (step + 1))
            if step:
                both = np.zeros((SIZE, size))
                both[:, own] = np.eye(SIZE)
                both[:, SIZE * (step - 1) : SIZE * step] = -self.into(step)
                information += both.T @ np.linalg.inv(self.noise[step]) @ both
            if step <= upto:
                information[own, own] += np.outer(self.h[step], self.h[step]) / 0.5
                right[own] += self.h[step] * self.z[step] / 0.5
        covariance = np.linalg.inv(information)
        return covariance @ right, covariance

    def pose(self, step: int, upto: int) -> tuple[np.ndarray, np.ndarray]:
        """Pose and covariance at the end of a step, of what was measured up to another one."""
        mean, covariance = self.joint(upto)
        own = slice(SIZE * step, SIZE * (step + 1))
        rows = self.f[step][PLACES]
        spread = rows @ covariance[own, own] @ rows.T
        spread[:2, :2] += self.shortened[step]
        return rows @ mean[own], spread


@pytest.fixture(scope="module", params=[1, 2])
def chain(request: pytest.FixtureRequest) -> Chain:
    return Chain(request.param)


@pytest.mark.parametrize("lag", [0, 1, 2, 10])
def test_with_a_lag_each_pose_is_that_of_what_was_measured_until_so_many_steps_later(
    chain: Chain, lag: int
) -> None:
    late, found, times = FixedLagSmoother(lag, PLACES), [], []
    for number, (at_once, terms) in enumerate(chain.filtered()):
        pose = late.add(at_once, terms)
        times.append(pose is not None)
        found += [] if pose is None else [pose]
        assert len(found) == max(0, number + 1 - lag)
    found += late.finish()
    assert late.finish() == []
    assert [pose.t for pose in found] == pytest.approx(0.1 * np.arange(STEPS))
    for step, pose in enumerate(found):
        mean, covariance = chain.pose(step, min(step + lag, STEPS - 1))
        np.testing.assert_allclose(pose[1:6], mean, atol=1e-7)
        assert (pose.motion_state, pose.nis, pose.dof) == (MotionState.MOVING, 1.0, 2)
        if lag:
            np.testing.assert_allclose(pose.covariance, covariance, atol=1e-7)
            assert np.array_equal(pose.covariance, pose.covariance.T)


def test_step_by_step_back_each_state_is_that_of_the_whole_log(chain: Chain) -> None:
    records = chain.filtered()
    mean, covariance = chain.joint(STEPS - 1)
    x, p = np.array(records[-1][1].x), records[-1][1].p
    for step in reversed(range(STEPS)):
        if step < STEPS - 1:
            x, p = step_back(records[step][1], records[step + 1][1], x, p, [])
            assert np.array_equal(p, p.T)
        own = slice(SIZE * step, SIZE * (step + 1))
        np.testing.assert_allclose(x, mean[own], atol=1e-7)
        np.testing.assert_allclose(p, covariance[own, own], atol=1e-7)
        made = smoothed_pose(*records[step], x, p, PLACES)
        expected, spread = chain.pose(step, STEPS - 1)
        np.testing.assert_allclose(made[1:6], expected, atol=1e-7)
        np.testing.assert_allclose(made.covariance, spread, atol=1e-7)
        assert made.t == records[step][0].t


@pytest.mark.parametrize("turns", [1.0, -2.0])
def test_a_wheel_that_is_turns_further_is_where_it_is(chain: Chain, turns: float) -> None:
    (_, one), (_, later) = chain.filtered()[:2]
    x, p = np.array(later.x), later.p
    further = x.copy()
    further[4] += 2.0 * np.pi * turns
    angles = step_back(one, later, further, p, [4])[0]
    assert angles == pytest.approx(step_back(one, later, x, p, [4])[0])
    assert np.abs(angles - step_back(one, later, further, p, [])[0]).max() > 0.01


def test_a_state_without_spread_tells_nothing_of_the_past() -> None:
    chain = Chain(3)
    (_, one), (_, later) = chain.filtered()[:2]
    known = later.prior_p.copy()
    known[4], known[:, 4] = 0.0, 0.0
    after = known.copy()
    sure = later._replace(prior_p=known, p=after)
    x = np.array(later.prior_x)
    x[4] += 100.0
    smoothed, spread = step_back(one, sure, x, after, [])
    np.testing.assert_allclose(smoothed, one.x, atol=1e-9)
    np.testing.assert_allclose(spread, one.p, atol=1e-9)
