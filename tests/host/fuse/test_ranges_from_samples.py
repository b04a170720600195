"""Clipping ranges detected in samples: repeated maxima, and samples beyond a declared range."""

import math

import numpy as np
import pytest

from hubodo.fuse.ranges import DEFAULT_RANGES, determine_ranges
from hubodo.recording import Table
from hubodo.vehicle import NodeMount

ROWS = {"gyro": ("gx", "gy", "gz"), "accel": ("ax", "ay", "az")}
DECLARED = {"gyro_range_dps": str(math.degrees(20.0)), "accel_range_g": str(40.0 / 9.80665)}
"""Declared ranges: 20 rad/s and 40 m/s²."""


def samples(kind, maximum, n_at_maximum=10, run_length=4, channel=2, repeated_share=0.0, largest=0.5):
    """Return a table whose channel has that many samples at its maximum, `run_length` of them in a row."""
    rng = np.random.default_rng(5)
    columns = {name: largest * rng.uniform(-1.0, 1.0, 500) for names in ROWS.values() for name in names}
    values = columns[ROWS[kind][channel]]
    # Counted among samples whose predecessor is below the maximum.
    values[
        300 : 300 + round(repeated_share * (499 - 2 * (n_at_maximum - run_length) - run_length - 1)) + 1
    ] = 0.1
    indices = list(range(100, 100 + run_length)) + list(range(200, 200 + 2 * (n_at_maximum - run_length), 2))
    values[indices] = maximum * (-1.0) ** np.arange(len(indices))
    return Table({"t": 0.01 * np.arange(500), **columns})


def detected_range(table, kind, declared=DECLARED):
    """Return the range of the gyro or the accelerometer, and the number of warnings."""
    result = determine_ranges(NodeMount(), declared, table)
    return getattr(result, kind).value, len(result.warnings)


@pytest.mark.parametrize("channel", [0, 1, 2])
@pytest.mark.parametrize(("kind", "declared", "end"), [("gyro", 20.0, 9.0), ("accel", 40.0, 20.0)])
def test_ten_samples_at_the_maximum_with_four_in_a_row_show_clipping(kind, declared, end, channel):
    for count, run_length, clips in ((10, 4, True), (9, 4, False), (10, 3, False), (30, 20, True)):
        value, n_warnings = detected_range(samples(kind, end, count, run_length, channel), kind)
        assert (value, n_warnings) == ((pytest.approx(end), 1) if clips else (pytest.approx(declared), 0))


def test_no_range_below_120_deg_per_s_or_two_g_is_detected():
    for kind, limit in (("gyro", math.radians(120.0)), ("accel", 1.9 * 9.80665)):
        for factor, clips in ((0.98, False), (1.02, True)):
            assert detected_range(samples(kind, factor * limit), kind)[1] == clips


@pytest.mark.parametrize(("share", "clips"), [(0.19, True), (0.21, False)])
def test_a_channel_that_repeats_values_shows_no_clipping(share, clips):
    """The limit is a fifth of the other samples equal to their predecessor."""
    assert detected_range(samples("gyro", 9.0, repeated_share=share), "gyro")[1] == clips


def test_the_range_is_the_smallest_of_several_clipping_channels():
    first, second = samples("gyro", 9.0), samples("gyro", 12.0, channel=0)
    both = Table({**first.columns, "gx": second["gx"]})
    assert detected_range(both, "gyro")[0] == pytest.approx(9.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_clipping_within_one_percent_confirms_the_declared_range(sign):
    for error, n_warnings in ((0.009, 0), (0.012, 1)):
        maximum = 20.0 * (1.0 + sign * error)
        assert detected_range(samples("gyro", maximum), "gyro") == (
            pytest.approx(maximum if n_warnings else 20.0),
            n_warnings,
        )


def test_samples_beyond_the_declared_range_extend_it():
    for factor, n_warnings in ((1.009, 0), (1.011, 1)):
        table = samples("gyro", 20.0 * factor, 1, 1)
        assert detected_range(table, "gyro") == (
            pytest.approx(1.01 * factor * 20.0 if n_warnings else 20.0),
            n_warnings,
        )
    # Without a declared range there is no warning.
    assert detected_range(samples("gyro", 50.0, 1, 1), "gyro", {}) == (pytest.approx(50.5), 0)
    assert detected_range(samples("gyro", 9.0, 1, 1), "gyro", {}) == (DEFAULT_RANGES["gyro"], 0)


@pytest.mark.parametrize("text", ["", "wide", "nan", "inf", "0", "-500"])
def test_an_invalid_range_reported_by_a_node_is_ignored(text):
    result = determine_ranges(NodeMount(), {"gyro_range_dps": text})
    assert (result.gyro.value, result.gyro.source) == (DEFAULT_RANGES["gyro"], "default")


def test_the_clipping_limit_is_lower_where_samples_are_corrected():
    for corrected, factor in ((False, 0.995), (True, 0.97)):
        limits = determine_ranges(NodeMount(), DECLARED, corrected=corrected).clipping_limits
        assert limits == pytest.approx({"gyro_limit": factor * 20.0, "accel_limit": factor * 40.0})
