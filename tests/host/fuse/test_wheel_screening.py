"""Samples of wheel nodes that are left out: a sensor that froze, a clock that went back; and gaps of one."""

import numpy as np
import pytest

from hubodo.fuse.wheel.node_screening import find_own_gaps, find_runs, screen_samples
from hubodo.recording import Table

STEP = 1.0 / 128.0
"""s; a time that adds up to the last bit."""


def node(t, gyro=None, accel=None):
    rng = np.random.default_rng(len(t))
    rows = np.hstack(
        [part if part is not None else rng.standard_normal((len(t), 3)) for part in (gyro, accel)]
    )
    return Table({"t": t, **dict(zip(("gx", "gy", "gz", "ax", "ay", "az"), rows.T, strict=True))})


def frozen(repeats, first=50, count=300):
    """One whose sample `first` comes again so many times."""
    t = np.arange(count) * STEP
    table = node(t)
    rows = np.hstack([table.gyro, table.accel])
    rows[first + 1 : first + 1 + repeats] = rows[first]
    return node(t, rows[:, :3], rows[:, 3:])


def turning(size, axis=2, step=STEP):
    """A wheel whose rate goes to and fro by so many rad/s, about a mean."""
    t = np.arange(round(300 * STEP / step)) * step
    gyro = np.zeros((len(t), 3))
    gyro[:, axis] = 4.0 + size * (-1.0) ** np.arange(len(t))
    return node(t, gyro)


def left_out(kept, whole):
    return sorted(set(whole.t.tolist()) - set(kept.t.tolist()))


@pytest.mark.parametrize(("repeats", "out"), [(64, 0), (65, 65), (120, 120)])
def test_half_a_second_without_a_change_is_left_out_where_the_other_wheel_turns(repeats, out):
    table = frozen(repeats)
    kept, said = screen_samples({"left": table, "right": turning(1.0)})
    assert left_out(kept["left"], table) == table.t[51 : 51 + out].tolist()
    assert len(said) == (out > 0)
    span = f"left: from t = {table.t[51]:.1f} to {table.t[50 + repeats]:.1f} s not one bit"
    assert all(span in line and "froze" in line for line in said)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize(("size", "out"), [(0.09, 0), (0.11, 100)])
def test_a_node_may_repeat_itself_while_the_other_wheel_stands(size, axis, out):
    table = frozen(100)
    kept, _ = screen_samples({"left": table, "right": turning(size, axis)})
    assert len(left_out(kept["left"], table)) == out
    assert screen_samples({"left": table})[0]["left"] is table


def test_another_wheel_that_is_hardly_heard_meanwhile_tells_nothing():
    """Of the 100 samples it says two, or three."""
    table = frozen(100)
    for times, out in (([0.5, 1.0], 0), ([0.5, 0.8, 1.1], 100)):
        t = np.array([0.1, *times, 2.0])
        other = node(t, np.column_stack([np.zeros((len(t), 2)), 5.0 * (-1.0) ** np.arange(len(t))]))
        kept, _ = screen_samples({"left": table, "right": other})
        assert len(left_out(kept["left"], table)) == out


@pytest.mark.parametrize("channel", range(6))
def test_one_bit_of_one_channel_is_a_change(channel):
    table = frozen(100)
    rows = np.hstack([table.gyro, table.accel])
    rows[51:151:2, channel] = np.nextafter(rows[50, channel], np.inf)
    other = node(table.t, rows[:, :3], rows[:, 3:])
    assert screen_samples({"left": other, "right": turning(1.0)})[0]["left"] is other


def crowded(times, share, before=100, after=100):
    """A node that says so many samples at a share of its usual distance, from number `before` on."""
    steps = np.concatenate([np.full(before, 1.0), np.full(times, share), np.full(after, 1.0)])
    return node(0.01 * np.cumsum(steps))


@pytest.mark.parametrize(
    ("times", "share", "out"), [(40, 0.59, 41), (40, 0.61, 0), (20, 0.59, 21), (19, 0.59, 0), (20, 0.01, 59)]
)
def test_twenty_samples_in_six_tenths_of_their_time_are_of_two_times(times, share, out):
    table = crowded(times, share)
    kept, said = screen_samples({"left": table, "right": turning(1.0)})
    assert len(left_out(kept["left"], table)) == pytest.approx(out, abs=0 if share > 0.1 else 20)
    if share > 0.1 and out:
        assert left_out(kept["left"], table) == table.t[99 : 99 + out].tolist()
    assert len(said) == (out > 0)
    assert all("its clock went back" in line for line in said)


def test_of_fewer_than_eighty_samples_nothing_is_usual():
    for before, out in ((59, 0), (60, 21)):
        table = crowded(20, 0.59, before, 0)
        assert len(table) == before + 20
        assert len(left_out(screen_samples({"left": table})[0]["left"], table)) == out


def test_what_is_both_is_said_once():
    t = crowded(60, 0.5).t
    table = frozen(120, 95, len(t))
    both = node(t, table.gyro, table.accel)
    kept, said = screen_samples({"left": both, "right": turning(1.0)})
    assert [("clock" in line, "froze" in line) for line in said] == [(True, False), (False, True)]
    assert left_out(kept["left"], both) == t[96:216].tolist()


def test_a_gap_that_another_table_has_as_well_is_not_its_own():
    def with_gaps(*begins):
        t = np.arange(0.0, 20.0, 0.05)
        for begin in begins:
            t = t[(t < begin + 0.01) | (t > begin + 0.5)]
        return node(t)

    left, right = with_gaps(3.0, 8.0, 12.0), with_gaps(3.05, 8.1, 15.0)
    found = find_own_gaps([left, right])
    # A gap begins with the last sample before it; 0.08 s apart they are one.
    assert found == [pytest.approx([8.0, 12.0]), pytest.approx([8.1, 15.0])]
    assert find_own_gaps([left]) == [pytest.approx([3.0, 8.0, 12.0])]
    for step, count in ((0.079, 0), (0.081, 1)):
        assert len(find_own_gaps([node(np.array([0.0, 0.05, 0.05 + step]))])[0]) == count


def test_stretches_are_the_first_and_last_of_flags_in_a_row():
    assert find_runs(np.array([1, 1, 0, 1, 0, 0, 1], bool)) == [(0, 1), (3, 3), (6, 6)]
    assert find_runs(np.zeros(3, bool)) == []
