"""Glitches of a gyro are left out, alike in bulk and live; jumps that stay are not glitches."""

import numpy as np
import pytest

from hubodo.fuse.wheel.filter import WheelFilter
from hubodo.fuse.wheel.glitches import GlitchFilter
from hubodo.fuse.wheel.preintegration import MAX_BRIDGED_GAP, WindowBuilder
from hubodo.fuse.wheel.track import run_wheel_filter, track_from_poses
from wheel_runs import config, sample_columns, samples_in_time_order, short_loop, tables

SHORT = short_loop(3)
STEP = 0.01


def accepted_times(gz, step=STEP):
    """Return the indices of the samples that a filter accepts."""
    glitches, indices = GlitchFilter(), [0]
    glitches.restart((0.0, 0.0, gz[0]))
    for index, rate in enumerate(gz[1:], start=1):
        indices += [round(t) for t, _ in glitches.add(step, float(index), (0.0, 0.0, rate))]
    return indices, glitches.n_rejected


@pytest.mark.parametrize("length", [1, 2, 3])
def test_up_to_three_samples_that_jump_and_return_are_left_out(length):
    gz = np.linspace(5.0, 8.0, 40)
    gz[10 : 10 + length] = -32.768
    expected = [index for index in range(40) if not 10 <= index < 10 + length]
    assert accepted_times(gz) == (expected, length)


def test_a_jump_that_stays_is_a_real_change_and_costs_no_sample():
    gz = np.where(np.arange(40) < 20, 5.0, 25.0)
    assert accepted_times(gz) == (list(range(40)), 0)


def test_noise_of_a_garbled_node_is_left_out_until_the_rate_returns():
    gz = np.full(60, 6.0)
    gz[20:45] = 30.0 * (-1.0) ** np.arange(25) + np.arange(25)
    assert accepted_times(gz) == ([*range(20), *range(45, 60)], 25)


def test_a_change_within_what_wheels_do_is_no_jump():
    """3 rad/s between samples, or 300 rad/s² between slow ones."""
    assert accepted_times([0.0, 2.9, 0.0, -2.9, 0.0])[1] == 0
    assert accepted_times([0.0, 14.0, 0.0, 14.0, 0.0], step=0.05)[1] == 0
    assert accepted_times([0.0, 14.0, 0.0, 14.0, 0.0])[1] == 2


def damaged(seed):
    """Return columns of both nodes; about one in 60 samples of the left one reads a rate of -32.768."""
    columns, rng = sample_columns(SHORT), np.random.default_rng(seed)
    t, gyro, accel = columns["left"]
    gyro = gyro.copy()
    rows = rng.integers(0, len(t), len(t) // 60)
    gyro[rows, rng.integers(0, 3, len(rows))] = -32.768
    gyro[1000:1012] = rng.uniform(-30.0, 30.0, (12, 3))
    return columns | {"left": (t, gyro, accel)}


def test_glitches_cost_samples_but_no_accuracy_in_bulk_and_live():
    for seed in (1, 2):
        columns = damaged(seed)
        bulk, live, poses = WheelFilter(config(SHORT)), WheelFilter(config(SHORT)), []
        bulk_poses = [*bulk.handle_blocks(columns).poses, *bulk.finish().poses]
        for sample in samples_in_time_order(columns):
            poses += live.handle(sample).poses
        poses += live.finish().poses
        tracks = [track_from_poses(run) for run in (bulk_poses, poses)]
        assert tracks[0].covariance.tobytes() == tracks[1].covariance.tobytes()
        assert bulk.rejected_samples == live.rejected_samples == bulk.glitches
        assert len(columns["left"][0]) / 70 < bulk.glitches["left"] < len(columns["left"][0]) / 40
        clean = run_wheel_filter(config(SHORT), tables(SHORT)).track
        assert np.hypot(tracks[0].x[-1] - clean.x[-1], tracks[0].y[-1] - clean.y[-1]) < 0.02


def test_garbage_for_longer_than_a_bridged_gap_is_a_pause():
    t = np.arange(0.0, 6.0, STEP)
    gyro = np.zeros((len(t), 3))
    gyro[:, 2] = 5.0
    garbled = (t > 2.0) & (t < 2.0 + MAX_BRIDGED_GAP + 0.3)
    gyro[garbled, 2] = 30.0 * (-1.0) ** np.arange(np.count_nonzero(garbled))
    builder = WindowBuilder("left", 0.0)
    windows = builder.add_many(t, gyro, np.zeros((len(t), 3)))
    numbers = [window.number for window in windows]
    assert builder.n_glitches == np.count_nonzero(garbled)
    assert numbers == [*range(20), *range(31, 59)]
    np.testing.assert_allclose([window.spin for window in windows], 0.5, atol=1e-9)
