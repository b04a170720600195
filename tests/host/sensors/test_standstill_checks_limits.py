"""Thresholds of the standstill checks, from both sides: units, noise, motion, temperature."""

import re
from itertools import pairwise

import numpy as np
import pytest

from hubodo.errors import InputError
from hubodo.sensors.standstill_checks import (
    _merge_spans,
    angle_random_walk,
    check_units,
    find_disturbances,
    find_temperature_step,
)

GYRO_NOISE, GYRO_OFFSET, GYRO_WHITE = 0.03, 0.35, 3e-3
SIZE = 100
"""Samples of a second."""


def gyro_of(noise, offset=0.0, count=8000, seed=1):
    return np.random.default_rng(seed).normal(0.0, noise, (count, 3)) + np.array([0.0, offset, 0.0])


def refused(gyro, interval=None):
    """Return the error text for the gyro, or "" if it is accepted."""
    try:
        check_units(gyro, None, interval)
    except InputError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("noise, accepted", [(0.029, True), (0.031, False)])
def test_the_noise_of_a_gyro_is_the_deviation_of_its_samples_and_knocks_are_none(noise, accepted):
    """1 sigma of a sample, determined by 8,000 samples."""
    gyro = gyro_of(noise) * np.array([0.2, 1.0, 0.5])
    gyro[::500] += 3.0
    text_part = refused(gyro)
    assert (text_part == "") == accepted
    if text_part:
        assert float(re.search(r"noise (\S+) per sample", text_part)[1]) == pytest.approx(noise, rel=0.04)
        assert "random walk" not in text_part and "deg/s" in text_part and "mdeg/s" not in text_part


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_offset_of_a_gyro_is_that_of_its_worst_axis_either_way(sign):
    assert refused(gyro_of(1e-3, 0.34 * sign)) == ""
    assert "offset 0.36" in refused(gyro_of(1e-3, 0.36 * sign))


@pytest.mark.parametrize("interval", [0.25, 0.1, 0.01])
def test_white_noise_is_that_of_the_worst_axis_whatever_the_rate(interval):
    """White noise sigma per sample is an angle random walk of sigma times the root of the interval."""
    gyro = gyro_of(0.01, 0.2) * np.array([0.3, 1.0, 0.5])
    assert angle_random_walk(gyro, interval) == pytest.approx(0.01 * np.sqrt(interval), rel=0.1)


def test_sixteen_quarters_of_a_second_are_the_least_for_white_noise():
    gyro = gyro_of(0.01)
    assert angle_random_walk(gyro[: 25 * 16 - 1], 0.01) == 0.0 < angle_random_walk(gyro[: 25 * 16], 0.01)


@pytest.mark.parametrize("share, accepted", [(0.9, True), (1.1, False)])
def test_white_noise_that_no_gyro_has_is_refused_by_its_angle_random_walk(share, accepted):
    interval = 0.04
    text_part = refused(gyro_of(share * GYRO_WHITE / np.sqrt(interval)), interval)
    assert (text_part == "") == accepted
    if text_part:
        reported = float(re.search(r"walk of (\S+) ", text_part)[1])
        assert reported == pytest.approx(np.degrees(share * GYRO_WHITE) * 60, rel=0.1)


@pytest.mark.parametrize("beyond, unit", [(0.95, "deg/s"), (1.05, "mdeg/s")])
@pytest.mark.parametrize("what", ["noise", "offset", "white"])
def test_rates_far_above_deg_per_s_are_identified_as_mdeg_per_s(what, beyond, unit):
    gyro, interval = {
        "noise": (gyro_of(30 * beyond * GYRO_NOISE), None),
        "offset": (gyro_of(1e-3, 60 * beyond * GYRO_OFFSET), None),
        "white": (gyro_of(30 * beyond * GYRO_WHITE / np.sqrt(0.04)), 0.04),
    }[what]
    assert f"it looks like {unit}," in refused(gyro, interval)


def test_a_column_that_was_not_measured_is_passed_over_and_the_others_are_not():
    gyro = gyro_of(1e-3)
    gyro[5, 0] = np.nan
    assert refused(gyro) == refused(np.full((9, 3), np.nan)) == ""
    gyro[:, 2] += 0.5
    assert "offset 0.5" in refused(gyro)


@pytest.mark.parametrize(
    "size, words",
    [
        (8.6, None),
        (11.1, None),
        (8.4, "no known unit"),
        (11.3, "no known unit"),
        (0.86, "that is g;"),
        (1.14, "that is g;"),
        (0.84, "no known unit"),
        (851.5, "that is mg;"),
        (98.07, "that is dm/s²;"),
        (1.000001e6, "that is µg;"),
        (16384.0, "raw counts"),
        (0.0, None),
    ],
)
def test_the_norm_of_gravity_identifies_the_unit(size, words):
    accel = np.tile([0.0, 0.0, -size], (50, 1))
    if words is None:
        check_units(None, accel)
        return
    with pytest.raises(InputError, match=words):
        check_units(None, accel)


def quiet(blocks, wander=0.5):
    """Return (N, 1) at 100 Hz: unit noise whose mean alternates by `wander` from second to second."""
    noise = np.tile([1.0, -1.0], SIZE // 2)
    level = wander * (-1.0) ** np.arange(blocks)
    return (level[:, None] + noise).reshape(-1, 1)


def found_in(values):
    return find_disturbances(np.arange(len(values)) / SIZE, values)


@pytest.mark.parametrize("sigmas, shifted", [(9.8, False), (10.2, True)])
@pytest.mark.parametrize("wander", [0.5, 0.0])
def test_a_step_of_ten_of_the_usual_steps_is_movement(sigmas, shifted, wander):
    """The usual step is the median one as a sigma, but at least that of unit noise, 1 / sqrt(100)."""
    usual = max(1.4826 * 2 * wander, 0.1)
    values = quiet(40, wander)
    values[20 * SIZE :] += sigmas * usual - 2 * wander
    assert bool(found_in(values)) == shifted
    if shifted:
        ((start, end),) = found_in(values)
        assert start == 19.0 and end == pytest.approx(21.0)


@pytest.mark.parametrize("times, shifted", [(2.80, False), (2.90, True)])
def test_a_second_that_is_far_noisier_is_movement(times, shifted):
    """The limit is twice, plus six sigma of the scatter of a deviation of 100 samples, 1 / sqrt(200)."""
    assert 2.80 < 2 * (1 + 6 / np.sqrt(2 * SIZE)) < 2.90
    values = np.hstack([quiet(40, 0.0), quiet(40, 0.0)])
    values[20 * SIZE : 21 * SIZE, 1] *= times
    assert bool(found_in(values)) == shifted


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_single_samples_however_far_off_are_no_movement_in_any_unit(unit):
    values = quiet(40, 0.0)
    values[[310, 2222, 3333]] = [[1e9], [-1e9], [50.0]]
    assert found_in(unit * values) == []
    values[20 * SIZE :] += 1.2
    assert len(found_in(unit * values)) == 1


def test_behind_a_coarse_converter_half_its_smallest_step_is_the_noise():
    """Single samples one or more steps off are no movement; a second on the next step is one."""
    values = np.zeros((40 * SIZE, 1))
    values[[500, 2000, 2950]] = [[1.0], [100.0], [-1.0]]
    assert found_in(values) == []
    values[3000:3100] = 1.0
    assert found_in(values) == [(29.0, 32.0)]


@pytest.mark.parametrize("rate, seconds", [(4.0, 2.0), (8.0, 1.0), (50.0, 1.0)])
def test_means_are_over_a_second_and_over_eight_samples_at_least(rate, seconds):
    size = int(rate * seconds)
    values = np.tile([1.0, -1.0], 20 * size)[:, None]
    values[20 * size :] += 20.0
    t = np.arange(len(values)) / rate
    assert find_disturbances(t, values) == [(19 * seconds, 21 * seconds)]


def test_a_channel_that_never_changes_hides_no_movement_of_another():
    still = np.zeros((40 * SIZE, 1))
    shifted = quiet(40, 0.0)
    shifted[20 * SIZE :] += 5.0
    assert found_in(np.hstack([still, quiet(40, 0.0)])) == []
    assert found_in(np.hstack([still, shifted])) == found_in(shifted) != []


@pytest.mark.parametrize("gap, stretches", [(5, 1), (6, 2)])
def test_movements_within_five_seconds_belong_together(gap, stretches):
    values = quiet(60, 0.0)
    for second in (20, 20 + gap + 1):
        values[second * SIZE : (second + 1) * SIZE] += 5.0
    spans = found_in(values)
    assert len(spans) == stretches
    assert spans[0][0] == 19.0 and spans[-1][1] == pytest.approx(20 + gap + 1 + 2)


@pytest.mark.parametrize("blocks, shifted", [(11, False), (12, True)])
def test_motion_is_detected_in_records_of_at_least_twelve_seconds(blocks, shifted):
    values = quiet(blocks, 0.0)
    values[-SIZE:] += 5.0
    assert found_in(values) == ([(blocks - 2.0, blocks - 1 / SIZE)] if shifted else [])


def test_spans_that_touch_are_one_and_all_are_in_order():
    rng = np.random.default_rng(6)
    for _ in range(50):
        begins = rng.integers(0, 30, 8)
        spans = [(float(b), float(b + n)) for b, n in zip(begins, rng.integers(1, 6, 8), strict=True)]
        built = _merge_spans(spans)
        held = [
            {k + 0.5 for k in range(40) if any(b < k + 0.5 < e for b, e in those)} for those in (spans, built)
        ]
        assert held[0] == held[1]
        assert all(before[1] < after[0] for before, after in pairwise(built))


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("degrees, reported", [(1.4, False), (1.6, True), (8.0, True)])
def test_a_step_of_temperature_is_more_than_a_degree_and_a_half_within_a_minute(degrees, reported, sign):
    t = np.arange(0.0, 1800.0, 0.5)
    result = find_temperature_step(t, 25.0 + sign * degrees * np.clip((t - 900.0) / 30.0, 0.0, 1.0))
    assert (result is not None) == reported
    if reported:
        assert result.change == pytest.approx(sign * degrees) and 840.0 <= result.t <= 960.0


@pytest.mark.parametrize("times, reported", [(3.5, False), (4.5, True)])
def test_a_step_is_four_times_the_change_of_the_minute_before(times, reported):
    """The temperature already changes before the step, as in a warm-up."""
    t = np.arange(0.0, 965.0, 0.5)
    temperature = np.interp(t, [0.0, 600.0, 900.0, 960.0], [20.0, 20.0, 25.0, 25.0 + times])
    assert (find_temperature_step(t, temperature) is not None) == reported


@pytest.mark.parametrize("seconds, reported", [(172.0, False), (190.0, True)])
def test_a_step_is_detected_from_three_minutes_on(seconds, reported):
    t = np.arange(0.0, seconds, 1.0)
    assert (find_temperature_step(t, 25.0 + 5.0 * (t >= 65.0)) is not None) == reported
