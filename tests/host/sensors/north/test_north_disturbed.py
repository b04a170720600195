"""North of records with standstills, cross-axis rates, blows, late clocks and wrong latitudes.

The records are products of attitude matrices and share no code with the estimators.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from generators.table_record import DEG_H, Carousel, Programme, table_record, table_rows
from hubodo.errors import InputError
from hubodo.recording import Table
from hubodo.sensors.north.axis_record import GyroAngleOptions, build_axis_record
from hubodo.sensors.north.circular import wrap_angle
from hubodo.sensors.north.disturbances import find_disturbed_spans
from hubodo.sensors.north.north_estimate import find_north
from hubodo.sensors.north.stops import TableMotion, split_stops

LATITUDE = np.radians(45)
NOISE = {"n": np.radians(0.002), "b": 0.5 * DEG_H, "k": 1e-8}
FOUR = Programme([180, -90, 180, -270, 180, -90, 180], [15.0] * 8, [60.0] * 7)
TWO = Programme([180, -180] * 3 + [180], [15.0] * 8, [60.0] * 7)


def estimate(
    programme,
    method,
    azimuth,
    *,
    seed=1,
    lag=0.0,
    latitude=LATITUDE,
    near=None,
    reverse=False,
    span=(0.0, np.inf),
    **world,
):
    """Return the north estimate from a record with table.csv, with all warnings; span: time range used, s."""
    rng = np.random.default_rng(seed)
    t, gyro, accel, _ = table_record(
        programme, rng, azimuth=azimuth, latitude=LATITUDE, hz=20.0, **{"noise": NOISE, **world}
    )
    node = Table(dict(zip(("t", "gx", "gy", "gz", "ax", "ay", "az"), (t, *gyro.T, *accel.T), strict=True)))
    rows = dict(zip(("t", "angle", "moving"), table_rows(programme, lag=lag), strict=True))
    if reverse:
        rows["angle"] = -rows["angle"]
    node, table = (
        Table({name: values[(one.t >= span[0]) & (one.t <= span[1])] for name, values in one.columns.items()})
        for one in (node, Table(rows))
    )
    record, notes = build_axis_record(node, "x", table, latitude, GyroAngleOptions(0.01))
    result = find_north([record], latitude, method, near=near)
    return replace(result, warnings=(*notes, *result.warnings))


def test_a_carousel_with_standstills_and_cross_axis_rate_reaches_its_bound():
    errors, sigmas, bounds = [], [], []
    for seed in range(8):
        azimuth = np.random.default_rng(100 + seed).uniform(-np.pi, np.pi)
        turns = Carousel(20.0, 150.0, 20.0, 20.0, ripple=0.01)
        result = estimate(turns, "carousel", azimuth, seed=seed, cross_axis=0.01)
        errors.append(float(wrap_angle(result.azimuth - azimuth)))
        sigmas.append(result.sigma)
        bounds.append(result.white_bound)
    z = np.array(errors) / sigmas
    print("seeds 0 to 7, error over sigma", z.round(2), "sigma over bound", np.mean(sigmas) / np.mean(bounds))
    assert np.mean(sigmas) < 1.1 * np.mean(bounds)
    # Chi-square with 8 degrees is below 26.1 in 99.9 %.
    assert 0.86 < np.sum(z**2) < 26.1


def test_a_late_clock_of_the_table_is_measured_where_the_turning_begins():
    result = estimate(Carousel(20.0, 150.0, 20.0, 20.0), "carousel", 1.0, lag=0.3, cross_axis=0.01)
    assert any("0.3" in text and "late against the node; corrected" in text for text in result.warnings)
    assert abs(wrap_angle(result.azimuth - 1.0)) < 3 * result.sigma
    steady = estimate(Carousel(0.0, 80.0, 0.0, 20.0), "carousel", 1.0, span=(5.0, 75.0))
    assert any("steady turning cannot show" in text for text in steady.warnings)


@pytest.mark.parametrize("lag", [0.8, -2.5, 4.0])
def test_stops_of_a_table_with_another_clock_are_corrected_by_the_turns_that_the_gyro_measures(lag):
    azimuth = np.radians(200)
    result = estimate(FOUR, "maytag4", azimuth, lag=lag)
    (note,) = (text for text in result.warnings if "against the node; corrected" in text)
    assert f"is {abs(lag):.1f}" in note and ("late" if lag > 0 else "early") in note
    assert len(result.stops[0]) == 8 and abs(wrap_angle(result.azimuth - azimuth)) < 3 * result.sigma
    same = estimate(FOUR, "maytag4", azimuth)
    assert abs(wrap_angle(result.azimuth - same.azimuth)) < result.sigma / 3
    assert not any("against the node" in text for text in same.warnings)


@pytest.mark.parametrize(
    "method, programme", [("carousel", Carousel(0.0, 60.0, 0.0, 20.0)), ("maytag4", FOUR)]
)
def test_angles_that_grow_clockwise_are_refused(method, programme):
    with pytest.raises(InputError, match="grows clockwise"):
        estimate(programme, method, 1.0, reverse=True)


def test_a_stop_with_a_blow_is_named_and_left_out():
    result = estimate(FOUR, "maytag4", np.radians(200), kick=(45.0, 0.3, np.radians(2)))
    (note,) = (text for text in result.warnings if "is excluded: a blow" in text)
    assert "the stop at 39.2..53.8 s" in note and len(result.stops[0]) == 7
    assert abs(wrap_angle(result.azimuth - np.radians(200))) < 3 * result.sigma < np.radians(30)


def test_a_blow_that_leaves_too_few_stops_is_named_in_the_refusal():
    short = Programme([180, -90, 180], [15.0] * 4, [60.0] * 3)
    with pytest.raises(InputError, match=r"3 stops are too few.*14\.8 s is excluded: a blow at"):
        estimate(short, "maytag4", 1.0, kick=(5.0, 0.3, np.radians(2)))


def test_blows_in_every_stop_are_refused_with_the_first():
    t = np.arange(1200) / 20
    rate = 1e-3 * np.random.default_rng(3).standard_normal((2, len(t)))
    moving = (t % 15 < 2).astype(bool)
    rate[:, (t % 15 > 8) & (t % 15 < 8.3)] += 0.03
    table = TableMotion(t, np.pi * np.floor(t / 15), moving)
    with pytest.raises(InputError, match=r"every stop is excluded; the stop at .* a blow at 7\.4"):
        split_stops(t, rate[0], table, vertical=rate[1])


def test_short_stops_without_a_blow_show_none():
    # Estimated without its own scatter, the usual deviation made a blow in one of nine such records.
    rng, step, edges = np.random.default_rng(4), 1 / 208, np.cumsum([0, 225, 210, 205, 240])
    spans = list(pairwise(edges.tolist()))
    records = [[rng.normal(0.0, 4.0, edges[-1]) for _ in range(2)] for _ in range(200)]
    assert not any(find_disturbed_spans(channels, spans, step) for channels in records)


@pytest.mark.parametrize("truth", [10, 30, 45, 150])
def test_two_points_give_the_highest_probability_and_both_answers(truth):
    result = estimate(TWO, "maytag", np.radians(truth), seed=truth)
    peak = result.posterior.azimuth[result.posterior.density.argmax()]
    assert abs(np.cos(result.azimuth) - np.cos(peak)) < 1e-3
    assert len(result.candidates) == 2 and any("two azimuths" in text for text in result.warnings)
    east, west = (
        estimate(TWO, "maytag", np.radians(truth), seed=truth, near=near).azimuth
        for near in np.radians([truth, -truth])
    )
    assert east == pytest.approx(-west) and abs(east - np.radians(truth)) < 2.5 * result.sigma
    assert result.white_bound == np.inf or result.white_bound < np.radians(104)


@pytest.mark.parametrize(
    "degrees, guess", [(75.0, "latitude of"), (0.785, "radians"), (-20.0, "north or south")]
)
def test_a_wrong_latitude_is_named_from_the_measured_earth_rate(degrees, guess):
    quiet = {"n": np.radians(0.0005), "b": 0.1 * DEG_H}
    result = estimate(FOUR, "maytag4", 1.0, latitude=np.radians(degrees), noise=quiet)
    assert result.earth_rate.probability < 1e-3
    (text,) = (text for text in result.warnings if "horizontal Earth rate were measured" in text)
    assert guess in text
    assert abs(wrap_angle(result.azimuth - 1.0)) < 2 * result.sigma
    if degrees == 75.0:
        with pytest.raises(InputError, match="horizontal Earth rate were measured"):
            estimate(TWO, "maytag", 0.1, latitude=np.radians(degrees), noise=quiet)
