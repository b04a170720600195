"""Stops and angles from the gyro alone: unusual records are split, and sigma includes the angle errors."""

import numpy as np
import pytest

from generators.table_record import Programme
from generators.table_worlds import FOUR, LATITUDE, WORLDS, even, odd, recorded, warming
from hubodo.errors import InputError
from hubodo.recording import Table
from hubodo.sensors.north.axis_record import GyroAngleOptions, build_axis_record
from hubodo.sensors.north.circular import wrap_angle
from hubodo.sensors.north.motion_from_gyro import _integrate_turns, find_table_motion
from hubodo.sensors.north.north_estimate import find_north
from hubodo.sensors.north.stops import split_stops
from repetitions import first_and_more


def found_in(node, *, step=None, method="maytag4", limit=np.inf):
    record, warnings = build_axis_record(node, "x", None, LATITUDE, GyroAngleOptions(0.01, step, limit))
    return find_north([record], LATITUDE, method), warnings


@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("count", first_and_more(3, 6))
def test_north_is_found_within_sigma_in_records_as_they_come(world, count):
    z = []
    for seed in range(count):
        node, azimuth, *_ = WORLDS[world](seed)
        result, _ = found_in(node)
        z.append(float(wrap_angle(result.azimuth - azimuth)) / result.sigma)
        assert result.sigma < np.radians(30)
    print(world, np.round(z, 2))
    # The rms of six values of unit sigma is below 1.75 in 99.9 % of cases.
    assert np.sqrt(np.mean(np.square(z))) < 1.75


def test_stops_match_the_table_and_turn_angles_match_to_the_gyro_scale():
    node, _, scale, stood = recorded(1, odd(1))
    motion = find_table_motion(node.t, node.gyro, np.array([0.0, 0.0, 1.0]), scale_sigma=0.01)
    stops = split_stops(node.t, node.gyro[:, 0], motion)
    # The nudge splits the first stop into two; of the stop of 2.5 s nothing remains.
    assert len(stops) == len(stood)
    for (start, end), angle in zip(stops.t, stops.angle, strict=True):
        true = stood[(stood[:, 0] - 0.1 < start) & (end < stood[:, 1] + 0.1)]
        assert len(true) == 1
        measured = np.degrees(angle) / (1 + scale)
        assert min(abs(measured - true[0, 2] - nudged) for nudged in (0.0, 1.3)) < 5 * np.degrees(
            motion.turn_sigma
        )
        assert end - start > true[0, 1] - true[0, 0] - 4.5 or angle < 0.1


def test_the_scale_of_the_gyro_is_in_sigma_and_a_step_that_is_asked_for_takes_it_out():
    """Eleven turns of 90 degrees in one direction are known to 1 %, 10 degrees at the last one."""
    node, azimuth, *_ = recorded(3, even(turns=[90] * 11), scale=0.02)
    measured, _ = found_in(node)
    exact, _ = found_in(node, step=np.pi / 2)
    assert measured.angle_sigma > np.radians(2.0) and exact.angle_sigma == 0.0
    assert exact.sigma < measured.sigma
    assert np.degrees(exact.stops[0].angle) == pytest.approx(90.0 * np.arange(12))
    for result in (measured, exact):
        assert abs(wrap_angle(result.azimuth - azimuth)) < 3.5 * result.sigma


def test_a_fine_gyro_finds_the_error_of_its_own_scale_from_earth_rate():
    """Most of the 15 degrees at the last of 11 turns is estimated: sigma is far below that of the prior."""
    node, azimuth, *_ = recorded(4, even(turns=[90] * 11), noise={"n": np.radians(3e-4)}, scale=0.015)
    result, _ = found_in(node)
    assert abs(wrap_angle(result.azimuth - azimuth)) < 4 * result.sigma < np.radians(10)
    assert result.angle_sigma < np.radians(3)


def test_warm_up_of_half_a_degree_per_second_is_not_mistaken_for_a_turn():
    node, azimuth, *_ = warming(8)
    result, _ = found_in(node)
    assert len(result.stops[0]) == 12
    assert abs(wrap_angle(result.azimuth - azimuth)) < 4 * result.sigma


def test_single_outliers_are_replaced_and_reported():
    node, azimuth, *_ = recorded(9, even())
    clean, _ = found_in(node)
    rng = np.random.default_rng(9)
    columns = {name: values.copy() for name, values in node.columns.items()}
    for name in ("gx", "gz"):
        columns[name][rng.integers(10, len(node) - 10, 20)] += rng.choice([-5.0, 5.0], 20)
    result, warnings = found_in(Table(columns))
    assert any("outliers of the gyro are replaced" in text for text in warnings)
    assert abs(wrap_angle(result.azimuth - clean.azimuth)) < 0.3 * clean.sigma
    assert abs(wrap_angle(result.azimuth - azimuth)) < 4 * result.sigma


def test_rows_without_numbers_are_left_out_and_an_axis_without_any_is_named():
    node, azimuth, *_ = recorded(9, even())
    columns = dict(node.columns)
    columns["gy"] = np.where(np.random.default_rng(9).random(len(node)) < 0.02, np.nan, node["gy"])
    result, warnings = found_in(Table(columns))
    assert any("rows with values that are not numbers" in text for text in warnings)
    assert abs(wrap_angle(result.azimuth - azimuth)) < 4 * result.sigma
    columns["gy"] = np.full(len(node), np.nan)
    with pytest.raises(InputError, match=r"no gy; provide table\.csv"):
        found_in(Table(columns))


def test_gravity_on_a_leaning_table_confirms_or_contradicts_the_signs_of_the_gyro():
    """A lean of 0.1 degrees is enough; a level table shows nothing, which is said."""
    for seed in range(3):
        level, *_ = recorded(seed, even())
        leaning, *_ = recorded(seed, even(), lean=(0.0012, 0.0013))
        assert any("nothing confirms the signs" in text for text in found_in(level)[1])
        assert not any("nothing confirms the signs" in text for text in found_in(leaning)[1])
        columns = {**leaning.columns, **{name: -leaning[name] for name in ("gx", "gz")}}
        with pytest.raises(InputError, match="gravity turns against the turns of the gyro"):
            found_in(Table(columns))


def test_a_turn_beyond_the_range_of_the_gyro_is_refused_unless_the_table_has_steps():
    node, *_ = recorded(10, even(rate=150.0))
    columns = dict(node.columns)
    columns["gz"] = np.clip(columns["gz"], -np.radians(125), np.radians(125))
    with pytest.raises(InputError, match=r"saturated in the turn at (19|20)\.\d s"):
        found_in(Table(columns), limit=np.radians(124))


@pytest.mark.parametrize("turns", [FOUR[:7], [-turn for turn in FOUR[:7]]])
def test_turns_of_either_way_have_their_sign_and_a_node_that_hangs_too(turns):
    node, azimuth, *_ = recorded(5, even(8, turns, stop=30.0), noise={"n": np.radians(1e-4)}, scale=0.0)
    # A node mounted upside down: rotated by half a turn about x, which keeps its direction.
    columns = {**node.columns, **{name: -node[name] for name in ("gy", "gz", "ay", "az")}}
    for observed in (node, Table(columns)):
        result, _ = found_in(observed)
        assert abs(wrap_angle(result.azimuth - azimuth)) < 4 * result.sigma < np.radians(4)


def test_vertical_earth_rate_on_a_tilted_table_is_corrected():
    """A lean of 2.3 degrees at 45 degrees north would rotate the result by as much."""
    node, azimuth, *_ = recorded(
        6, even(stop=30.0), noise={"n": np.radians(1e-4)}, scale=0.0, lean=(0.04, 0.0)
    )
    result, warnings = found_in(node)
    assert any("tilted by 2.2" in text for text in warnings)
    assert abs(wrap_angle(result.azimuth - azimuth)) < 4 * result.sigma < np.radians(3)


@pytest.mark.parametrize(
    "change, words",
    [
        ({"programme": Programme([], [60.0], [])}, "never turned"),
        ({"step": np.radians(60)}, "not a multiple of 60"),
        ({"missing": True}, "samples are missing in the turn at 19"),
        ({"tipped": True}, "about another axis"),
    ],
    ids=["no turn", "step", "gap", "tipped"],
)
def test_what_cannot_be_split_ends_in_words(change, words):
    node, *_ = recorded(7, change.get("programme", even(6)))
    rows = np.ones(len(node), bool)
    columns = dict(node.columns)
    if change.get("missing"):
        rows = (node.t < 22) | (node.t > 24)
    if change.get("tipped"):
        columns["gy"] = columns["gy"] + 0.3 * ((node.t > 10) & (node.t < 12))
    node = Table({name: values[rows] for name, values in columns.items()})
    with pytest.raises(InputError, match=words):
        found_in(node, step=change.get("step"))


@pytest.mark.parametrize(("step", "bears"), [(0.04, 0.2), (0.01, 0.1)])
def test_a_turn_bears_a_gap_of_five_samples_or_a_tenth_of_a_second(step, bears):
    t = np.arange(0.0, 12.0, step)
    moving = (t > 4.0) & (t < 8.0)
    for gap, refused in ((0.9 * bears, False), (1.1 * bears, True)):
        late = np.where(t > 6.0, t - step + gap, t)
        if refused:
            with pytest.raises(InputError, match="samples are missing in the turn at 4"):
                _integrate_turns(late, np.zeros((len(t), 3)), moving)
        else:
            assert len(_integrate_turns(late, np.zeros((len(t), 3)), moving)) == 1
