"""Clipping ranges detected in samples: repeated maxima, and samples beyond a declared range."""

import math

import numpy as np
import pytest

from hubodo.fuse.ranges import DEFAULT_RANGES, determine_ranges
from hubodo.recording import Table
from hubodo.vehicle import NodeMount

ROWS = {"gyro": ("gx", "gy", "gz"), "accel": ("ax", "ay", "az")}
DECLARED = {"gyro_range_dps": str(math.degrees(20.0)), "accel_range_g": str(40.0 / 9.80665)}
"""20 rad/s and 40 m/s²."""


def samples(kind, end, count=10, run=4, channel=2, repeats=0.0, largest=0.5):
    """Return a channel with so many samples at its maximum, so many in a row, others alternating."""
    rng = np.random.default_rng(5)
    columns = {name: largest * rng.uniform(-1.0, 1.0, 500) for names in ROWS.values() for name in names}
    values = columns[ROWS[kind][channel]]
    # Counted among samples whose predecessor is below the maximum.
    values[300 : 300 + round(repeats * (499 - 2 * (count - run) - run - 1)) + 1] = 0.1
    places = list(range(100, 100 + run)) + list(range(200, 200 + 2 * (count - run), 2))
    values[places] = end * (-1.0) ** np.arange(len(places))
    return Table({"t": 0.01 * np.arange(500), **columns})


def check(table, kind, declared=DECLARED):
    result = determine_ranges(NodeMount(), declared, table)
    return getattr(result, kind).value, len(result.warnings)


@pytest.mark.parametrize("channel", [0, 1, 2])
@pytest.mark.parametrize(("kind", "declared", "end"), [("gyro", 20.0, 9.0), ("accel", 40.0, 20.0)])
def test_ten_samples_at_the_maximum_with_four_in_a_row_show_clipping(kind, declared, end, channel):
    for count, run, piles in ((10, 4, True), (9, 4, False), (10, 3, False), (30, 20, True)):
        value, messages = check(samples(kind, end, count, run, channel), kind)
        assert (value, messages) == ((pytest.approx(end), 1) if piles else (pytest.approx(declared), 0))


def test_no_range_below_120_deg_per_s_or_two_g_is_detected():
    for kind, edge in (("gyro", math.radians(120.0)), ("accel", 1.9 * 9.80665)):
        for share, piles in ((0.98, False), (1.02, True)):
            assert check(samples(kind, share * edge), kind)[1] == piles


@pytest.mark.parametrize(("share", "piles"), [(0.19, True), (0.21, False)])
def test_a_channel_without_noise_shows_no_clipping(share, piles):
    """The limit is a fifth of the other samples."""
    assert check(samples("gyro", 9.0, repeats=share), "gyro")[1] == piles


def test_the_range_is_the_smallest_of_several_clipping_channels():
    first, second = samples("gyro", 9.0), samples("gyro", 12.0, channel=0)
    both = Table({**first.columns, "gx": second["gx"]})
    assert check(both, "gyro")[0] == pytest.approx(9.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_clipping_within_a_percent_of_the_declared_range_is_the_declared_range(sign):
    for error, messages in ((0.009, 0), (0.012, 1)):
        end = 20.0 * (1.0 + sign * error)
        assert check(samples("gyro", end), "gyro") == (pytest.approx(end if messages else 20.0), messages)


def test_samples_beyond_the_declared_range_show_no_clipping():
    for share, messages in ((1.009, 0), (1.011, 1)):
        table = samples("gyro", 20.0 * share, 1, 1)
        assert check(table, "gyro") == (pytest.approx(1.01 * share * 20.0 if messages else 20.0), messages)
    # Without a declared range there is no warning.
    assert check(samples("gyro", 50.0, 1, 1), "gyro", {}) == (pytest.approx(50.5), 0)
    assert check(samples("gyro", 9.0, 1, 1), "gyro", {}) == (DEFAULT_RANGES["gyro"], 0)


@pytest.mark.parametrize("text", ["", "wide", "nan", "inf", "0", "-500"])
def test_an_invalid_range_reported_by_a_node_is_ignored(text):
    result = determine_ranges(NodeMount(), {"gyro_range_dps": text})
    assert (result.gyro.value, result.gyro.source) == (DEFAULT_RANGES["gyro"], "default")


def test_the_clipping_limit_is_lower_where_samples_are_corrected():
    for corrected, share in ((False, 0.995), (True, 0.97)):
        limits = determine_ranges(NodeMount(), DECLARED, corrected=corrected).clipping_limits
        assert limits == pytest.approx({"gyro_limit": share * 20.0, "accel_limit": share * 40.0})
