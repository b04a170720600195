"""Tracking of wheel angles."""

import numpy as np

from hubodo.gap.process_noise.tracking import track_wheel_phase


def test_a_tracked_state_is_hardly_changed_by_tracking_it_again(evaluation):
    again, walks = track_wheel_phase(evaluation.state)
    for name, offset in evaluation.state.phase_offsets.items():
        np.testing.assert_allclose(again.phase_offsets[name], offset, atol=1e-3)
        assert walks[name] > 0.0
