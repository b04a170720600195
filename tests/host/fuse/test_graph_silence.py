"""The graph over an odometry with a silence, hours perhaps: poses stand there at what was measured alone."""

import numpy as np

from hubodo.fuse.graph.build import _choose_pose_times


def test_poses_stand_at_the_ends_of_a_silence_and_at_marks_in_it_alone():
    day = 86_400.0
    path_t = np.concatenate([np.arange(0.0, 10.05, 0.1), day + np.arange(0.0, 10.05, 0.1)])
    found = _choose_pose_times(path_t, np.array([3.3, 500.0, day + 4.4]), 1.0)
    inside = found[(found > 10.01) & (found < day - 0.01)]
    assert inside.tolist() == [500.0]
    assert np.abs(found - 10.0).min() < 1e-9 and np.abs(found - day).min() < 1e-9
    for begin in (0.0, day):
        own = found[(found >= begin) & (found <= begin + 10.01)]
        assert np.diff(own).max() <= 1.0 + 1e-9
