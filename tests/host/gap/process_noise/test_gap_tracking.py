"""Tracking of wheel phases."""

import numpy as np

from hubodo.gap.process_noise.tracking import track_wheel_phase


def test_tracking_a_tracked_state_changes_it_by_less_than_a_millirad(evaluation):
    tracked_again, walks = track_wheel_phase(evaluation.state)
    for name, offset in evaluation.state.phase_offsets.items():
        np.testing.assert_allclose(tracked_again.phase_offsets[name], offset, atol=1e-3)
        assert walks[name] > 0.0
