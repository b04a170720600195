"""Motions without a model: a recording, and standstill."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from hubodo.emulator.motion import Motion, RecordedMotion, StillMotion


def recording(start: float = 0.0) -> RecordedMotion:
    t = np.array([10.0, 10.5, 12.0])
    return RecordedMotion(
        t, np.outer([1.0, 2.0, 5.0], [1, 0, -1]), np.ones((3, 3)), [20.0, 21.0, 24.0], start=start
    )


def test_between_samples_a_recording_is_linear_and_outside_it_holds_its_ends() -> None:
    motion = recording(start=3.0)
    t = np.array([0.0, 3.25, 3.5, 4.25, 5.0, 99.0])
    assert motion.angular_rate(t)[:, 0] == pytest.approx([1, 1.5, 2, 3.5, 5, 5])
    assert motion.angular_rate(t)[:, 2] == pytest.approx([-1, -1.5, -2, -3.5, -5, -5])
    assert motion.temperature(t) == pytest.approx([20, 20.5, 21, 22.5, 24, 24])
    assert motion.duration == 5.0


def test_a_recording_whose_time_does_not_increase_is_refused_with_the_sample() -> None:
    with pytest.raises(ValueError, match="sample 2"):
        RecordedMotion(np.array([0.0, 1.0, 1.0]), np.zeros((3, 3)), np.zeros((3, 3)))


def test_arrays_of_different_length_are_refused() -> None:
    with pytest.raises(ValueError, match=r"\(3,\)"):
        RecordedMotion(np.arange(3.0), np.zeros((2, 3)), np.zeros((3, 3)))


def test_motions_are_motions_and_can_be_sent_to_another_process() -> None:
    t = np.linspace(0, 6, 50)
    for motion in (recording(), StillMotion(rate=(0.1, 0.2, 0.3))):
        assert isinstance(motion, Motion)
        copy = pickle.loads(pickle.dumps(motion))
        assert np.array_equal(copy.angular_rate(t), motion.angular_rate(t))
        assert np.array_equal(copy.magnetic_field(t), motion.magnetic_field(t))
