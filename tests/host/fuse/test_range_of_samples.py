"""Where the samples of a node end, by the samples themselves: piles of them, and what goes beyond."""

import math

import numpy as np
import pytest

from hubodo.fuse.ranges import DEFAULT_RANGES, determine_ranges
from hubodo.recording import Table
from hubodo.vehicle import NodeMount

ROWS = {"gyro": ("gx", "gy", "gz"), "accel": ("ax", "ay", "az")}
TOLD = {"gyro_range_dps": str(math.degrees(20.0)), "accel_range_g": str(40.0 / 9.80665)}
"""20 rad/s and 40 m/s²."""


def samples(kind, end, count=10, run=4, channel=2, repeats=0.0, largest=0.5):
    """A channel that stands so often at its end, so many times in a row at most, and else goes to and fro."""
    rng = np.random.default_rng(5)
    columns = {name: largest * rng.uniform(-1.0, 1.0, 500) for names in ROWS.values() for name in names}
    values = columns[ROWS[kind][channel]]
    # Of those that follow another one which is not at the end.
    values[300 : 300 + round(repeats * (499 - 2 * (count - run) - run - 1)) + 1] = 0.1
    places = list(range(100, 100 + run)) + list(range(200, 200 + 2 * (count - run), 2))
    values[places] = end * (-1.0) ** np.arange(len(places))
    return Table({"t": 0.01 * np.arange(500), **columns})


def seen(table, kind, told=TOLD):
    found = determine_ranges(NodeMount(), told, table)
    return getattr(found, kind).value, len(found.warnings)


@pytest.mark.parametrize("channel", [0, 1, 2])
@pytest.mark.parametrize(("kind", "declared", "end"), [("gyro", 20.0, 9.0), ("accel", 40.0, 20.0)])
def test_ten_samples_at_the_end_of_all_four_of_them_in_a_row_make_a_pile(kind, declared, end, channel):
    for count, run, piles in ((10, 4, True), (9, 4, False), (10, 3, False), (30, 20, True)):
        value, said = seen(samples(kind, end, count, run, channel), kind)
        assert (value, said) == ((pytest.approx(end), 1) if piles else (pytest.approx(declared), 0))


def test_no_sensor_ends_before_120_degrees_a_second_or_two_g():
    for kind, edge in (("gyro", math.radians(120.0)), ("accel", 1.9 * 9.80665)):
        for share, piles in ((0.98, False), (1.02, True)):
            assert seen(samples(kind, share * edge), kind)[1] == piles


@pytest.mark.parametrize(("share", "piles"), [(0.19, True), (0.21, False)])
def test_a_channel_that_repeats_itself_anywhere_says_nothing_of_its_end(share, piles):
    """A fifth of its other samples."""
    assert seen(samples("gyro", 9.0, repeats=share), "gyro")[1] == piles


def test_of_several_channels_that_end_the_least_is_where_they_do():
    first, second = samples("gyro", 9.0), samples("gyro", 12.0, channel=0)
    both = Table({**first.columns, "gx": second["gx"]})
    assert seen(both, "gyro")[0] == pytest.approx(9.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_end_within_a_hundredth_of_what_was_told_is_that(sign):
    for off, said in ((0.009, 0), (0.012, 1)):
        end = 20.0 * (1.0 + sign * off)
        assert seen(samples("gyro", end), "gyro") == (pytest.approx(end if said else 20.0), said)


def test_samples_that_go_beyond_what_was_told_end_nowhere_that_they_show():
    for share, said in ((1.009, 0), (1.011, 1)):
        table = samples("gyro", 20.0 * share, 1, 1)
        assert seen(table, "gyro") == (pytest.approx(1.01 * share * 20.0 if said else 20.0), said)
    # Where nobody told a range nothing has to be said.
    assert seen(samples("gyro", 50.0, 1, 1), "gyro", {}) == (pytest.approx(50.5), 0)
    assert seen(samples("gyro", 9.0, 1, 1), "gyro", {}) == (DEFAULT_RANGES["gyro"], 0)


@pytest.mark.parametrize("text", ["", "wide", "nan", "inf", "0", "-500"])
def test_what_a_node_tells_that_is_no_range_is_not_heard(text):
    found = determine_ranges(NodeMount(), {"gyro_range_dps": text})
    assert (found.gyro.value, found.gyro.source) == (DEFAULT_RANGES["gyro"], "default")


def test_what_counts_as_clipped_begins_just_below_and_further_below_where_samples_are_corrected():
    for corrected, share in ((False, 0.995), (True, 0.97)):
        limits = determine_ranges(NodeMount(), TOLD, corrected=corrected).clipping_limits
        assert limits == pytest.approx({"gyro_limit": share * 20.0, "accel_limit": share * 40.0})
