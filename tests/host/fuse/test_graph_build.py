"""Construction of the graph: poses in an odometry outage."""

import numpy as np

from hubodo.fuse.graph.build import _choose_pose_times


def test_an_odometry_outage_has_poses_only_at_its_ends_and_at_samples_within():
    day = 86_400.0
    path_t = np.concatenate([np.arange(0.0, 10.05, 0.1), day + np.arange(0.0, 10.05, 0.1)])
    result = _choose_pose_times(path_t, np.array([3.3, 500.0, day + 4.4]), 1.0)
    inside = result[(result > 10.01) & (result < day - 0.01)]
    assert inside.tolist() == [500.0]
    assert np.abs(result - 10.0).min() < 1e-9 and np.abs(result - day).min() < 1e-9
    for start in (0.0, day):
        selected = result[(result >= start) & (result <= start + 10.01)]
        assert np.diff(selected).max() <= 1.0 + 1e-9
