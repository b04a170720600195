"""Fixed-lag and full smoothing against the joint distribution of the states of all steps."""

from __future__ import annotations

import numpy as np
import pytest

from hubodo.fuse.wheel.fixed_lag import FixedLagSmoother
from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.records import MeasurementTerms, Pose, SmoothingTerms, StateChange, StateTransition
from hubodo.fuse.wheel.smoother import smooth_whole_log

SIZE, STEPS = 7, 6
POSE_COLUMNS = [1, 0, 2, 4, 6]


class LinearChain:
    """A linear system with one measurement per step, filtered in the order of the wheel filter.

    State 3 is reset in step 2; state 5 is a combination of others before the measurement of step 3; a further
    transition, as over an outage, precedes step 4.
    """

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)

        def random_transition() -> np.ndarray:
            return np.eye(SIZE) + 0.2 * rng.standard_normal((SIZE, SIZE))

        self.f = [random_transition() for _ in range(STEPS)]
        self.outage_transition = random_transition()
        self.combination = rng.standard_normal(SIZE)
        self.h = rng.standard_normal((STEPS, SIZE))
        self.z = rng.standard_normal(STEPS)
        self.noise = []
        for _ in range(STEPS):
            root = 0.3 * rng.standard_normal((SIZE, SIZE))
            self.noise.append(root @ root.T)
        self.inflation = [np.diag([*rng.uniform(0.1, 0.2, 2), 0.0, 0.0, 0.0]) for _ in range(STEPS)]

    def transition_to(self, step: int) -> np.ndarray:
        """Return the derivative of the states before a step's measurement by those after the previous one."""
        transition = self.f[step - 1]
        if step == 2:
            transition = transition.copy()
            transition[3] = 0.0
        if step == 3:
            transition = transition.copy()
            transition[5] = self.combination @ self.f[2]
        return self.outage_transition @ transition if step == 4 else transition

    def filtered(self) -> list[tuple[Pose, SmoothingTerms]]:
        """Return pose and smoothing terms of every step of a Kalman filter."""
        x, p, records = np.zeros(SIZE), np.eye(SIZE), []
        for step in range(STEPS):
            changes: list[StateChange] = []
            if step == 2:
                changes.append(StateTransition([3]))
            if step == 3:
                changes.append(StateTransition.of_rows([5], self.combination))
            if step == 4:
                changes.append(StateTransition.of_rows(range(SIZE), self.outage_transition))
            h = self.h[step]
            changes.append(MeasurementTerms.of_row(0.0, h, h, 1.0))
            changes.append(StateTransition.of_rows(range(SIZE), self.f[step]))
            for number, change in enumerate(changes):
                if isinstance(change, StateTransition):
                    f = np.eye(SIZE)
                    f[change.columns] = change.rows(SIZE)
                    x, p = f @ x, f @ p @ f.T
                else:
                    p = p + self.noise[step] if step else p
                    s, residual = h @ p @ h + 0.5, self.z[step] - h @ x
                    changes[number] = MeasurementTerms.of_row(residual, h, p @ h, s)
                    x, p = x + p @ h / s * residual, p - np.outer(p @ h, p @ h) / s
            terms = SmoothingTerms(changes, p[POSE_COLUMNS], self.inflation[step])
            pose = Pose(0.1 * step, *x[POSE_COLUMNS], np.zeros((5, 5)), MotionState.MOVING, 1.0, 2)
            records.append((pose, terms))
        return records

    def joint(self, last_measured: int) -> tuple[np.ndarray, np.ndarray]:
        """Return mean and covariance of the states of all steps given the measurements up to one step."""
        size = SIZE * STEPS
        information, information_vector = np.zeros((size, size)), np.zeros(size)
        information[:SIZE, :SIZE] = np.eye(SIZE)
        for step in range(STEPS):
            block = slice(SIZE * step, SIZE * (step + 1))
            if step:
                rows = np.zeros((SIZE, size))
                rows[:, block] = np.eye(SIZE)
                rows[:, SIZE * (step - 1) : SIZE * step] = -self.transition_to(step)
                information += rows.T @ np.linalg.inv(self.noise[step]) @ rows
            if step <= last_measured:
                information[block, block] += np.outer(self.h[step], self.h[step]) / 0.5
                information_vector[block] += self.h[step] * self.z[step] / 0.5
        covariance = np.linalg.inv(information)
        return covariance @ information_vector, covariance

    def pose(self, step: int, last_measured: int) -> tuple[np.ndarray, np.ndarray]:
        """Return pose and covariance at the end of a step given the measurements up to another step."""
        mean, covariance = self.joint(last_measured)
        block = slice(SIZE * step, SIZE * (step + 1))
        rows = self.f[step][POSE_COLUMNS]
        pose_covariance = rows @ covariance[block, block] @ rows.T
        pose_covariance += self.inflation[step]
        return rows @ mean[block], pose_covariance


@pytest.fixture(scope="module", params=[1, 2])
def linear_chain(request: pytest.FixtureRequest) -> LinearChain:
    return LinearChain(request.param)


@pytest.mark.parametrize("lag", [0, 1, 2, 10])
def test_a_fixed_lag_pose_uses_the_measurements_up_to_lag_steps_later(
    linear_chain: LinearChain, lag: int
) -> None:
    smoother, poses, is_ready = FixedLagSmoother(lag, POSE_COLUMNS), [], []
    for number, (forward_pose, terms) in enumerate(linear_chain.filtered()):
        pose = smoother.add(forward_pose, terms)
        is_ready.append(pose is not None)
        poses += [] if pose is None else [pose]
        assert len(poses) == max(0, number + 1 - lag)
    poses += smoother.finish()
    assert smoother.finish() == []
    assert [pose.t for pose in poses] == pytest.approx(0.1 * np.arange(STEPS))
    for step, pose in enumerate(poses):
        mean, covariance = linear_chain.pose(step, min(step + lag, STEPS - 1))
        np.testing.assert_allclose(pose[1:6], mean, atol=1e-7)
        assert (pose.motion_state, pose.nis, pose.dof) == (MotionState.MOVING, 1.0, 2)
        if lag:
            np.testing.assert_allclose(pose.covariance, covariance, atol=1e-7)
            assert np.array_equal(pose.covariance, pose.covariance.T)


def test_the_backward_pass_gives_the_joint_estimate_of_all_measurements(linear_chain: LinearChain) -> None:
    poses, terms = map(list, zip(*linear_chain.filtered(), strict=True))
    smoothed = smooth_whole_log(poses, terms, POSE_COLUMNS)
    assert terms == []
    for step, pose in enumerate(smoothed):
        mean, covariance = linear_chain.pose(step, STEPS - 1)
        np.testing.assert_allclose(pose[1:6], mean, atol=1e-12)
        np.testing.assert_allclose(pose.covariance, covariance, atol=1e-12)
        assert np.array_equal(pose.covariance, pose.covariance.T)
        assert (pose.t, pose.nis, pose.dof) == (poses[step].t, 1.0, 2)
