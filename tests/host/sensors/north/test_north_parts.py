"""Parts of north finding: stops, filters, drift covariance, serial turntables."""

import numpy as np
import pytest
from scipy.integrate import dblquad
from serial import Serial

from fakes.fake_table import FakeTable
from generators.noise import gyro_noise
from generators.north_table import Sensor, maytag
from hubodo.earth import EARTH_RATE
from hubodo.errors import InputError, LinkError
from hubodo.sensors.north.averages import average_spans
from hubodo.sensors.north.drift import (
    DriftNoise,
    drift_covariance,
    flicker_covariance,
    random_walk_covariance,
)
from hubodo.sensors.north.filters import CLASSICAL_FILTERS, filter_weights, find_opposite_pairs, stop_signs
from hubodo.sensors.north.likelihood import estimate_earth_rate
from hubodo.sensors.north.measurements import _half_turn_rates
from hubodo.sensors.north.mount import check_turn_direction, describe_table_tilt, estimate_mount
from hubodo.sensors.north.stops import Stops, TableMotion, split_stops
from hubodo.sensors.north.turntable import ManualTable, SerialTable

LATITUDE = np.radians(45)
DT = 0.02


def test_the_allan_deviation_of_each_noise_is_that_of_ieee_952():
    """Annex C: sqrt(3) Q / tau, N / sqrt(tau), B sqrt(2 ln 2 / pi), K sqrt(tau / 3); squares add up."""
    tau = np.array([0.5, 12.0, 300.0])
    each = [np.sqrt(3.0) * 7.0 / tau, 5.0 / np.sqrt(tau), 0.6643 * 3.0 + 0.0 * tau, 2.0 * np.sqrt(tau / 3.0)]
    alone = [
        DriftNoise(0.0, 0.0, 0.0, 7.0),
        DriftNoise(5.0, 0.0, 0.0),
        DriftNoise(0.0, 3.0, 0.0),
        DriftNoise(0.0, 0.0, 2.0),
    ]
    for drift, deviation in zip(alone, each, strict=True):
        assert drift.allan_deviation(tau) == pytest.approx(deviation, rel=1e-4)
    together = DriftNoise(5.0, 3.0, 2.0, 7.0).allan_deviation(tau)
    assert together == pytest.approx(np.sqrt(np.sum(np.square(each), axis=0)), rel=1e-4)


def run_of(seed, *, transient=0.02, stops=8, stop=20.0):
    rng = np.random.default_rng(seed)
    error = Sensor(0.1, 0.5, 1).error(int(stops * (stop + 2) / DT) + 10, DT, rng)
    return maytag(
        error,
        DT,
        0.3,
        LATITUDE,
        list(np.resize([0.0, np.pi], stops)),
        stop,
        2.0,
        transient=transient,
        rng=rng,
    )


def table_of(run):
    return TableMotion(run.table_t, run.table_angle, run.table_moving)


def test_one_recording_is_split_into_its_stops_and_the_transients_are_cut():
    run = run_of(1)
    stops = split_stops(run.t, run.rate, table_of(run), vertical=run.vertical)
    assert len(stops) == 8
    # 0.02 rad/s decaying with 0.15 s is below 1e-8 rad/s after 2.2 s, and visible for about half of that.
    assert 0.6 < stops.cut[0] < 4.0
    clean = run_of(1, transient=0.0)
    same = split_stops(clean.t, clean.rate, table_of(clean), settle=stops.cut[0])
    assert np.abs(stops.mean - same.mean).max() < 2e-6


def test_without_transients_little_is_cut():
    run = run_of(2, transient=0.0)
    assert max(split_stops(run.t, run.rate, table_of(run)).cut) <= 1.0


def test_a_table_that_moves_during_a_stop_is_detected_by_the_vertical_gyro():
    run = run_of(3)
    vertical = run.vertical.copy()
    inside = (run.t > 50) & (run.t < 55)
    vertical[inside] += np.radians(0.6)
    with pytest.raises(InputError, match=r"stop 3, 4[4-6].*is 3\.0 degrees"):
        split_stops(run.t, run.rate, table_of(run), vertical=vertical)


def test_a_table_file_whose_angle_changes_while_still_is_refused_with_the_time():
    run = run_of(4)
    t = np.append(run.table_t[:-1], [run.table_t[-1] - 5, run.table_t[-1]])
    angle = np.append(run.table_angle[:-1], [run.table_angle[-1] + 0.01, run.table_angle[-1] + 0.01])
    with pytest.raises(InputError, match=r"0\.57 degrees while moving is 0"):
        split_stops(run.t, run.rate, TableMotion(t, angle, np.append(run.table_moving[:-1], [False, False])))


@pytest.mark.parametrize("name", CLASSICAL_FILTERS)
@pytest.mark.parametrize("count", [4, 5, 9, 20, 21])
def test_every_filter_gives_the_rate_whatever_the_bias(name, count):
    sign = np.where(np.arange(count) % 2 == 0, 1, -1)
    w = filter_weights(name, sign)
    assert w[sign > 0].sum() == pytest.approx(0.5) and w[sign < 0].sum() == pytest.approx(-0.5)
    assert w @ (7.0 + 0.0035 * sign) == pytest.approx(0.0035)


def test_nearest_neighbour_is_the_thesis_formula_and_swanson_schlamminger_its_weights():
    sign = np.array([1, -1, 1, -1, 1])
    assert np.allclose(filter_weights("nearest", sign) * 8, [1, -2, 2, -2, 1])
    # 1/(N+1), -1/(N-1), .. for N = 5 stops in total.
    assert np.allclose(filter_weights("swanson_schlamminger", sign), [1 / 6, -1 / 4, 1 / 6, -1 / 4, 1 / 6])


@pytest.mark.parametrize("name, lag", [("next_nearest", 3), ("next_next_nearest", 5)])
def test_the_wider_filters_relate_each_stop_to_two_and_three_opposite_ones_on_each_side(name, lag):
    sign = np.where(np.arange(21) % 2 == 0, 1, -1)
    pairs = find_opposite_pairs(sign, lag)
    partners = (pairs.first == 10).sum()
    assert partners == lag + 1
    assert np.allclose(
        np.bincount(pairs.first, minlength=21) + np.bincount(pairs.second, minlength=21),
        2 * len(pairs.first) * np.abs(filter_weights(name, sign)),
    )


def test_filters_refuse_unknown_names_and_missing_directions():
    with pytest.raises(InputError, match="in the same direction"):
        filter_weights("nearest", np.array([1, 1, 1]))
    with pytest.raises(InputError, match="unknown"):
        filter_weights("neares", np.array([1, -1]))
    assert list(stop_signs(np.radians([0, 181, 90, 359, 5]), 0.0)) == [1, -1, 0, 1, 0]


def test_random_walk_and_flicker_covariances_equal_their_integrals():
    start, end = np.array([0.0, 2.0, 7.0]), np.array([1.5, 5.0, 8.0])
    walk = random_walk_covariance(start, end)
    for i in range(3):
        for j in range(3):
            area = (end[i] - start[i]) * (end[j] - start[j])
            exact = dblquad(lambda u, v: min(u, v), start[i], end[i], start[j], end[j], epsabs=1e-4)[0] / area
            assert walk[i, j] == pytest.approx(exact, rel=1e-3)
    assert np.linalg.eigvalsh(flicker_covariance(start, end)).min() > 0


def test_the_covariance_is_the_sum_of_three_independent_noises():
    """White noise averages as n² / T, a walk as K² times the integral of min; the noises are independent."""
    start, end = np.array([0.0, 2.0, 7.0]), np.array([1.5, 5.0, 8.0])
    n, b, k = 2.0, 3.0, 0.5
    assert drift_covariance(DriftNoise(n, 0.0, 0.0), start, end) == pytest.approx(
        np.diag(n**2 / (end - start))
    )
    walked = drift_covariance(DriftNoise(0.0, 0.0, k), start, end)
    # Two consecutive intervals share the mean of the walk over the first one.
    assert walked[0, 1] == pytest.approx(k**2 * (start[0] + end[0]) / 2, rel=1e-12)
    # The variance of the mean of a walk over T from its start is K² T / 3.
    assert walked[0, 0] == pytest.approx(k**2 * 1.5 / 3, rel=1e-12)
    assert walked[2, 2] == pytest.approx(k**2 * (7.0 + 1.0 / 3), rel=1e-12)
    flickered = drift_covariance(DriftNoise(0.0, b, 0.0), start, end)
    assert np.linalg.eigvalsh(flickered).min() > 0
    assert drift_covariance(DriftNoise(n, b, k), start, end) == pytest.approx(
        np.diag(n**2 / (end - start)) + flickered + walked, rel=1e-12
    )


def test_the_allan_deviation_of_the_flicker_covariance_is_flat_at_0_664():
    t = np.arange(512.0)
    c = flicker_covariance(t, t + 1)
    for m in (4, 16, 64):
        d = np.zeros(512)
        d[200 : 200 + m], d[200 + m : 200 + 2 * m] = -1 / m, 1 / m
        assert np.sqrt(d @ c @ d / 2) == pytest.approx(np.sqrt(2 * np.log(2) / np.pi), rel=0.03)


def test_the_covariance_is_that_of_simulated_drift():
    drift = DriftNoise(0.0, 1.0, 0.05)
    start = np.arange(12) * 12.0
    model = drift_covariance(drift, start, start + 10)
    w = filter_weights("nearest", np.where(np.arange(12) % 2 == 0, 1, -1))
    result = []
    for seed in range(400):
        x = gyro_noise(1440, 0.1, np.random.default_rng(seed), b=1.0, k=0.05)
        result.append(w @ np.array([x[int(10 * s) : int(10 * s) + 100].mean() for s in start]))
    # 400 values determine a standard deviation to 3.5 %.
    assert np.std(result) == pytest.approx(np.sqrt(w @ model @ w), rel=0.12)


@pytest.mark.parametrize("squeezed", [0.3, 0.1, 1e-3, 0.0])
def test_a_stop_whose_stamps_stand_closer_than_its_samples_is_left_out(squeezed):
    """Some stamps are too close, as from a delayed node; four other stops still give the result."""
    rng, t, spans = np.random.default_rng(1), np.zeros(0), []
    for stop in range(5):
        spans.append((len(t), len(t) + 200))
        own = 0.01 * (squeezed if stop == 0 else 1.0)
        t = np.append(t, (t[-1] + 1.5 if stop else 0.0) + own * np.arange(200))
    angle = np.repeat(np.pi / 2 * np.arange(5), 200)
    observed = average_spans(t, rng.normal(0.0, 0.002, 1000), angle, spans, 0.25)
    assert len(observed.y) == 4 * 8 and observed.start[0] >= 1.5
    assert (observed.start[1:] >= observed.end[:-1] - 1e-9).all()
    assert np.isfinite(estimate_earth_rate([observed], 4.9e-5).rate_covariance).all()
    with pytest.raises(InputError, match="no part of any stop"):
        estimate_earth_rate([observed.slice_rows(0, 0)], 4.9e-5)


def test_gravity_gives_the_direction_of_y_and_a_vertical_axis_is_refused():
    accel, gyro = np.zeros((200, 3)), np.zeros((200, 3))
    accel[:, 2] = 9.81
    assert estimate_mount(gyro, accel, "y").mounting_angle == pytest.approx(np.pi / 2)
    assert estimate_mount(gyro, -accel, "y").mounting_angle == pytest.approx(-np.pi / 2)
    assert estimate_mount(gyro, accel, "x").mounting_angle == 0
    with pytest.raises(InputError, match="degrees from level"):
        estimate_mount(gyro, accel, "z")


def test_a_table_file_with_clockwise_angles_is_detected():
    run = run_of(5)
    count = len(run.t)
    gyro = np.column_stack([run.rate, np.zeros(count), run.vertical])
    accel = np.tile([0, 0, 9.81], (count, 1))
    check_turn_direction(estimate_mount(gyro, accel, "x"), run.t, table_of(run))
    with pytest.raises(InputError, match="clockwise"):
        check_turn_direction(
            estimate_mount(gyro, accel, "x"),
            run.t,
            TableMotion(run.table_t, -run.table_angle, run.table_moving),
        )


def test_a_gyro_in_degrees_per_second_is_detected_by_the_table_rotations():
    run = run_of(5)
    gyro = np.degrees(np.column_stack([run.rate, run.rate, run.vertical]))
    with pytest.raises(InputError, match="degrees per second"):
        check_turn_direction(
            estimate_mount(gyro, np.tile([0, 0, 9.81], (len(gyro), 1)), "x"), run.t, table_of(run)
        )


def test_a_tilted_table_is_reported_with_its_consequence():
    run = run_of(6)
    rng = np.random.default_rng(0)
    angle = np.interp(run.t, run.table_t, run.table_angle)
    lean = 9.81 * np.radians(1.0) * np.cos(angle)
    accel = np.column_stack([lean, 0 * lean, np.full(len(lean), 9.81)]) + 0.05 * rng.standard_normal(
        (len(lean), 3)
    )
    gyro = np.column_stack([run.rate, run.rate, run.vertical])
    words = describe_table_tilt(estimate_mount(gyro, accel, "x"), run.t, table_of(run))
    assert "tilted by 1.0" in words[0]
    accel[:, 0] -= lean
    assert describe_table_tilt(estimate_mount(gyro, accel, "x"), run.t, table_of(run)) == []


def test_a_serial_table_is_driven_over_a_real_port():
    with FakeTable() as fake, Serial(fake.path, 115200, timeout=5) as port:
        assert SerialTable(port).turn_to(np.radians(-90.0)) == pytest.approx(np.radians(-90.0))
        assert fake.visited == [pytest.approx(-90.0)]


def test_a_table_with_limits_reaches_an_angle_by_the_other_turn():
    with FakeTable(limits=(-180.0, 185.0)) as fake, Serial(fake.path, 115200, timeout=5) as port:
        table = SerialTable(port)
        reached = [np.degrees(table.turn_to(np.radians(angle))) for angle in (0, 180, 270, 90, 450, -200)]
    assert reached == pytest.approx([0, 180, -90, 90, 90, 160])
    with FakeTable(limits=(0.0, 100.0)) as fake, Serial(fake.path, 115200, timeout=5) as port:
        table = SerialTable(port)
        with pytest.raises(InputError, match=r"from 0 to 100 degrees and cannot reach 180\.0"):
            table.turn_to(np.pi)
        assert fake.visited == []


def test_a_table_that_is_turning_already_is_waited_for_and_noise_on_the_line_is_asked_again():
    waits = []
    with FakeTable(garbled=3) as fake, Serial(fake.path, 115200, timeout=5) as port:
        table = SerialTable(port, waits.append)
        for degrees in (10.0, 20.0, 30.0):
            assert np.degrees(table.turn_to(np.radians(degrees))) == pytest.approx(degrees)
        assert set(fake.visited) == {10.0, 20.0, 30.0}


@pytest.mark.parametrize(
    "fault, words, stopped",
    [
        ({"off": 0.5}, "stopped at", 0),
        ({"silent": True}, "answered nothing", 0),
        ({"jammed": True}, "ERR jammed", 1),
        ({"stuck": True}, "is busy but has stood", 1),
        ({"version": 2}, "protocol version 2", 0),
    ],
)
def test_a_table_that_misses_or_does_not_answer_is_an_error_and_is_stopped(fault, words, stopped):
    with (
        FakeTable(**fault) as fake,
        Serial(fake.path, 115200, timeout=0.1) as port,
        pytest.raises(LinkError, match=words),
    ):
        SerialTable(port, lambda seconds: None).turn_to(1.0)
    assert fake.stopped == stopped or not stopped


def test_manual_turns_are_requested_with_direction_and_angle():
    lines = []
    table = ManualTable(lines.append)
    for degrees in (0.0, 180.0, 90.0, -37.5):
        table.turn_to(np.radians(degrees))
    assert [line.partition(" on its scale")[0] for line in lines] == [
        "turn the table to 0.0°",
        "turn the table by 180.0° anticlockwise seen from above, to 180.0°",
        "turn the table by 90.0° clockwise seen from above, to 90.0°",
        "turn the table by 127.5° clockwise seen from above, to 322.5°",
    ]
    assert all(line.endswith("press Enter: ") for line in lines)


def test_a_table_that_nobody_can_turn_is_an_error():
    def closed(line):
        raise EOFError

    with pytest.raises(InputError, match="--table PORT"):
        ManualTable(closed).turn_to(1.0)


def test_earth_turns_once_in_a_mean_sidereal_day():
    # IERS: a mean sidereal day has 86164.0905 s.
    assert pytest.approx(2 * np.pi / 86164.0905, rel=1e-8) == EARTH_RATE


def test_pairs_of_stops_that_turn_about_give_the_rate_along_the_first_of_them():
    """A bias is equal in both and cancels; of 0, 180, 270, 90 degrees the middle two are not a pair."""
    angle = np.radians([0.0, 180.0, 270.0, 90.0])
    times = np.array([[10.0 * k, 10.0 * k + 8.0] for k in range(4)])
    at = 400 * np.arange(4)
    stops = Stops(at, at + 300, times, angle, 2e-3 + 5e-5 * np.cos(angle - 0.4), (0.0, 0.0))
    np.testing.assert_allclose(
        _half_turn_rates(stops), 5e-5 * np.cos(angle[[0, 2]] - 0.4), rtol=1e-9, atol=1e-15
    )
