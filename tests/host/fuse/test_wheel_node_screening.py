"""Screening of wheel nodes: frozen sensors, clocks that went back, and gaps of a single node."""

import numpy as np
import pytest

from hubodo.fuse.wheel.node_screening import find_own_gaps, screen_samples
from hubodo.recording import Table

STEP = 1.0 / 128.0
"""Sample interval, s; a power of two, so that sums of it are exact."""


def node_table(t, gyro=None, accel=None):
    rng = np.random.default_rng(len(t))
    rows = np.hstack(
        [part if part is not None else rng.standard_normal((len(t), 3)) for part in (gyro, accel)]
    )
    return Table({"t": t, **dict(zip(("gx", "gy", "gz", "ax", "ay", "az"), rows.T, strict=True))})


def frozen_node(repeats, first=50, count=300):
    """Return a node whose sample `first` is repeated that many times, with rates of 0.1 rad/s."""
    t = np.arange(count) * STEP
    table = node_table(t)
    rows = np.hstack([0.1 * table.gyro, table.accel])
    rows[first + 1 : first + 1 + repeats] = rows[first]
    return node_table(t, rows[:, :3], rows[:, 3:])


def rotating_node(size, axis=2, step=STEP):
    """Return a node of a wheel whose rate alternates by ± `size` rad/s about a mean."""
    t = np.arange(round(300 * STEP / step)) * step
    gyro = np.zeros((len(t), 3))
    gyro[:, axis] = 0.4 + size * (-1.0) ** np.arange(len(t))
    return node_table(t, gyro)


def removed_times(screened, original):
    """Return the times of the samples that screening removed."""
    return sorted(set(original.t.tolist()) - set(screened.t.tolist()))


@pytest.mark.parametrize(("repeats", "n_removed"), [(64, 0), (65, 65), (120, 120)])
def test_samples_frozen_for_half_a_second_are_removed_if_the_other_wheel_turns(repeats, n_removed):
    table = frozen_node(repeats)
    screened, warnings = screen_samples({"left": table, "right": rotating_node(1.0)})
    assert removed_times(screened["left"], table) == table.t[51 : 51 + n_removed].tolist()
    assert len(warnings) == (n_removed > 0)
    span = f"left: from t = {table.t[51]:.1f} to {table.t[50 + repeats]:.1f} s not one bit"
    assert all(span in line and "froze" in line for line in warnings)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize(("size", "n_removed"), [(0.09, 0), (0.11, 100)])
def test_frozen_samples_stay_while_the_other_wheel_is_stationary(size, axis, n_removed):
    table = frozen_node(100)
    screened, _ = screen_samples({"left": table, "right": rotating_node(size, axis)})
    assert len(removed_times(screened["left"], table)) == n_removed
    assert screen_samples({"left": table})[0]["left"] is table


def test_the_other_wheel_needs_three_samples_to_show_that_it_turns():
    """During the 100 frozen samples the other wheel has two, or three."""
    table = frozen_node(100)
    for times, n_removed in (([0.5, 1.0], 0), ([0.5, 0.8, 1.1], 100)):
        t = np.array([0.1, *times, 2.0])
        other = node_table(t, np.column_stack([np.zeros((len(t), 2)), 5.0 * (-1.0) ** np.arange(len(t))]))
        screened, _ = screen_samples({"left": table, "right": other})
        assert len(removed_times(screened["left"], table)) == n_removed


@pytest.mark.parametrize("channel", range(6))
def test_a_single_bit_of_one_channel_is_a_change(channel):
    table = frozen_node(100)
    rows = np.hstack([table.gyro, table.accel])
    rows[51:151:2, channel] = np.nextafter(rows[50, channel], np.inf)
    other = node_table(table.t, rows[:, :3], rows[:, 3:])
    assert screen_samples({"left": other, "right": rotating_node(1.0)})[0]["left"] is other


def interleaved_node(count, factor, before=100, after=100):
    """Return a node with `count` samples at a fraction of the usual interval, after `before` usual ones."""
    steps = np.concatenate([np.full(before, 1.0), np.full(count, factor), np.full(after, 1.0)])
    return node_table(0.01 * np.cumsum(steps))


@pytest.mark.parametrize(
    ("count", "factor", "n_removed"),
    [(40, 0.59, 41), (40, 0.61, 0), (20, 0.59, 21), (19, 0.59, 0), (20, 0.01, 59)],
)
def test_twenty_samples_within_0_6_of_their_duration_are_interleaved(count, factor, n_removed):
    table = interleaved_node(count, factor)
    screened, warnings = screen_samples({"left": table, "right": rotating_node(1.0)})
    assert len(removed_times(screened["left"], table)) == pytest.approx(
        n_removed, abs=0 if factor > 0.1 else 20
    )
    if factor > 0.1 and n_removed:
        assert removed_times(screened["left"], table) == table.t[99 : 99 + n_removed].tolist()
    assert len(warnings) == (n_removed > 0)
    assert all("its clock went back" in line for line in warnings)


def test_interleaving_needs_eighty_samples_for_the_usual_interval():
    for before, n_removed in ((59, 0), (60, 21)):
        table = interleaved_node(20, 0.59, before, 0)
        assert len(table) == before + 20
        assert len(removed_times(screen_samples({"left": table})[0]["left"], table)) == n_removed


def test_a_run_that_is_interleaved_and_frozen_is_removed_once():
    t = interleaved_node(60, 0.5).t
    table = frozen_node(120, 95, len(t))
    both = node_table(t, table.gyro, table.accel)
    screened, warnings = screen_samples({"left": both, "right": rotating_node(1.0)})
    assert [("clock" in line, "froze" in line) for line in warnings] == [(True, False), (False, True)]
    assert removed_times(screened["left"], both) == t[96:216].tolist()


def test_a_common_gap_of_two_tables_is_not_an_own_gap():
    def with_gaps(*starts):
        t = np.arange(0.0, 20.0, 0.05)
        for start in starts:
            t = t[(t < start + 0.01) | (t > start + 0.5)]
        return node_table(t)

    left, right = with_gaps(3.0, 8.0, 12.0), with_gaps(3.05, 8.1, 15.0)
    gaps = find_own_gaps([left, right])
    # A gap starts at the last sample before it; starts up to 0.08 s apart belong to one gap.
    assert gaps == [pytest.approx([8.0, 12.0]), pytest.approx([8.1, 15.0])]
    assert find_own_gaps([left]) == [pytest.approx([3.0, 8.0, 12.0])]
    for step, count in ((0.079, 0), (0.081, 1)):
        assert len(find_own_gaps([node_table(np.array([0.0, 0.05, 0.05 + step]))])[0]) == count


def test_two_nodes_that_freeze_together_are_removed_while_they_turn():
    """A logger repeats its last message of both; 3 rad/s for 0.78 s are 2.3 rad, 2 rad/s 1.6 rad."""
    for rate, n_removed in ((3.0, 100), (2.0, 0)):
        table = frozen_node(100)
        gyro, accel = table.gyro.copy(), table.accel.copy()
        gyro[50:151] = 0.0, 0.0, rate
        table = node_table(table.t, gyro, accel)
        screened, _ = screen_samples({"left": table, "right": table})
        assert all(len(removed_times(node, table)) == n_removed for node in screened.values())
