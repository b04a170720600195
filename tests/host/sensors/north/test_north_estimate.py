"""North: every method estimates the azimuth within its sigma, on independently simulated tables."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from generators.north_table import Sensor, carousel, earth_in_sensor, maytag
from hubodo.errors import CalibrationError, InputError
from hubodo.sensors.north.axis_record import AxisRecord
from hubodo.sensors.north.circular import fuse_azimuths, summarise_azimuth, wrap_angle
from hubodo.sensors.north.drift import DriftNoise
from hubodo.sensors.north.east import seek_east
from hubodo.sensors.north.north_estimate import find_north, horizontal_earth_rate
from hubodo.sensors.north.simulated_table import SimulatedTable, simulate_stops
from hubodo.sensors.north.stops import TableMotion
from repetitions import first_and_more

LATITUDE = np.radians(32.7574)
TACTICAL = Sensor(0.05, 0.2, 0.3)
DT = 0.1
POINTS = {"maytag": [0.0, np.pi], "maytag4": [0.0, np.pi, np.pi / 2, 1.5 * np.pi]}


def table_of(run):
    return TableMotion(run.table_t, run.table_angle, run.table_moving)


def record_of(run):
    return AxisRecord(run.t, run.rate, table_of(run))


def built(seed, method, azimuth, *, sensor=TACTICAL, stops=20, stop=20.0, latitude=LATITUDE, transient=0.0):
    rng = np.random.default_rng(seed)
    error = sensor.error(int(stops * (stop + 2) / DT) + 10, DT, rng)
    return maytag(
        error,
        DT,
        azimuth,
        latitude,
        list(np.resize(POINTS[method], stops)),
        stop,
        2.0,
        transient=transient,
        rng=rng,
    )


@pytest.mark.parametrize("method", first_and_more("maytag4", "maytag"))
def test_stops_find_the_azimuth_with_an_honest_sigma_over_25_seeds(method):
    z = []
    for seed in range(25):
        azimuth = np.random.default_rng(seed).uniform(-np.pi, np.pi)
        run = built(seed, method, azimuth)
        result = find_north([record_of(run)], LATITUDE, method, settle=1.0, near=azimuth)
        z.append(float(wrap_angle(result.azimuth - azimuth)) / result.sigma)
    # The rms of 25 values scatters by 14 %; the tolerance is three times that. No value is beyond 4.
    assert 0.58 < np.sqrt(np.mean(np.square(z))) < 1.42, z
    assert np.abs(z).max() < 4


def test_a_carousel_finds_the_azimuth_with_an_honest_sigma_near_the_white_noise_bound():
    z, ratio = [], []
    for seed in range(14):
        rng = np.random.default_rng(seed)
        azimuth = rng.uniform(-np.pi, np.pi)
        run = carousel(TACTICAL.error(3700, DT, rng), DT, azimuth, LATITUDE, 30.0, 360.0)
        result = find_north([record_of(run)], LATITUDE, "carousel")
        z.append(float(wrap_angle(result.azimuth - azimuth)) / result.sigma)
        ratio.append(result.sigma / result.white_bound)
        assert len(result.rates) == len(result.rates_across) == 12
    # The rms of 14 values scatters by 19 %.
    assert 0.5 < np.sqrt(np.mean(np.square(z))) < 1.57, z
    # With fast turns against this drift, sigma cannot be below that of white noise and should be close to it.
    assert 0.75 < np.median(ratio) < 1.35


def test_the_white_noise_bound_is_sqrt_2_over_t_times_n_over_horizontal_rate():
    rng = np.random.default_rng(1)
    run = carousel(Sensor(0.42, 0, 0).error(36100, DT, rng), DT, 1.0, np.radians(45), 60.0, 3600.0)
    drift = DriftNoise(np.radians(0.42) / 60, 0.0, 0.0)
    result = find_north([record_of(run)], np.radians(45), "carousel", drift=drift)
    # The usual figure: 0.42 deg/√h and one hour give 3.2 degrees with one axis.
    assert np.degrees(result.white_bound) == pytest.approx(3.2, abs=0.05)
    assert result.sigma == pytest.approx(result.white_bound, rel=0.02)


def test_east_seeking_stops_east_and_never_west():
    for seed in range(5):
        rng = np.random.default_rng(seed)
        # The start points west, or nearly: the other zero of the loop.
        azimuth = -np.pi / 2 + rng.uniform(-0.05, 0.05)
        table = SimulatedTable(TACTICAL.error(9000, DT, rng), DT, azimuth, LATITUDE)
        result = seek_east(table, table.measure, horizontal_earth_rate(LATITUDE), stop=20.0, steps=8)
        assert abs(wrap_angle(azimuth - result.angle - np.pi / 2)) < np.radians(5)
        assert abs(wrap_angle(result.azimuth - azimuth)) < 4 * result.sigma
        assert len(result.steps) == 8


def test_a_log_of_an_east_seeking_session_gives_the_azimuth():
    rng = np.random.default_rng(3)
    table = SimulatedTable(TACTICAL.error(9000, DT, rng), DT, 0.7, LATITUDE)
    angles = [0, np.pi, 0, np.pi / 2, 1.5 * np.pi, np.pi / 2, -0.9, -0.9 + np.pi, -0.9, -0.87, -0.87 + np.pi]
    t, rate, table_motion = simulate_stops(table, np.array(angles), 30.0)
    result = find_north([AxisRecord(t, rate, table_motion)], LATITUDE, "east")
    assert abs(wrap_angle(result.azimuth - 0.7)) < 4 * result.sigma < np.radians(10)
    assert len(result.rates) == 7


@settings(max_examples=8)
@given(st.floats(-np.pi, np.pi), st.floats(-1.2, 1.2), st.floats(-np.pi, np.pi))
def test_turning_table_zero_turns_the_answer(azimuth, latitude, shift):
    angles = np.resize(POINTS["maytag4"], 12)
    quiet = SimulatedTable(1e-7 * np.random.default_rng(0).standard_normal(4000), DT, azimuth, latitude)
    t, rate, table = simulate_stops(quiet, angles, 20.0)
    result = find_north([AxisRecord(t, rate, table)], latitude, "maytag4")
    assert abs(wrap_angle(result.azimuth - azimuth)) < 1e-2
    turned = TableMotion(table.t, table.angle + shift, table.moving)
    again = find_north([AxisRecord(t, rate, turned)], latitude, "maytag4")
    assert abs(wrap_angle(again.azimuth - azimuth - shift)) < 1e-2
    mounted = find_north([AxisRecord(t, rate, table, shift)], latitude, "maytag4")
    assert abs(wrap_angle(mounted.azimuth - azimuth - shift)) < 1e-2


@pytest.mark.parametrize("shift", [0.4, 2.0])
def test_the_component_of_a_line_has_the_same_sigma_whichever_way_the_line_points(shift):
    run = built(2, "maytag", 0.7)
    (plain,), (sigma,) = find_north([record_of(run)], LATITUDE, "maytag").rate_components()
    turned = AxisRecord(run.t, run.rate, table_of(run), shift)
    (rate,), (result,) = find_north([turned], LATITUDE, "maytag").rate_components()
    assert rate == pytest.approx(plain, rel=1e-4, abs=0.0) and result == pytest.approx(
        sigma, rel=1e-4, abs=0.0
    )


def test_signs_from_first_principles():
    # An axis to the north measures all of it, to the south its negative, to the east nothing; west is
    # anticlockwise of north.
    for azimuth, angle, share in (
        (0, 0, 1),
        (np.pi, 0, -1),
        (np.pi / 2, 0, 0),
        (0, np.pi / 2, 0),
        (np.pi / 2, np.pi / 2, 1),
    ):
        measured = earth_in_sensor(azimuth, np.array([angle]), LATITUDE)[0]
        assert measured == pytest.approx(share * horizontal_earth_rate(LATITUDE), rel=1e-5, abs=1e-12)


def test_stops_along_one_line_say_that_two_azimuths_remain():
    run = built(1, "maytag", np.radians(60))
    result = find_north([record_of(run)], LATITUDE, "maytag", settle=1.0)
    assert len(result.candidates) == 2
    assert min(abs(wrap_angle(c - np.radians(60))) for c in result.candidates) < 4 * result.sigma
    assert float(wrap_angle(sum(result.candidates))) == pytest.approx(0, abs=1e-6)
    assert "two azimuths" in result.warnings[0]
    west = find_north([record_of(run)], LATITUDE, "maytag", settle=1.0, near=np.radians(-50))
    assert west.azimuth == pytest.approx(-result.azimuth)


def test_pointing_north_two_points_give_north_with_the_sigma_of_the_flat_cosine():
    run = built(2, "maytag", 0.0)
    result = find_north([record_of(run)], LATITUDE, "maytag", settle=1.0)
    # The maximum is north itself, so both sides of it are reported; --near-deg selects one.
    assert abs(result.azimuth) < 1e-9 and result.candidates[0] == pytest.approx(-result.candidates[1])
    east, west = (
        find_north([record_of(run)], LATITUDE, "maytag", settle=1.0, near=near).azimuth
        for near in (0.5, -0.5)
    )
    assert east == pytest.approx(-west) and 0 < east < 2 * result.sigma
    # Where the cosine is flat no bound exists, so none is printed.
    assert result.white_bound == np.inf and result.bound == np.inf
    rate, sigma = result.rate_components()
    assert abs(rate[0] - horizontal_earth_rate(LATITUDE)) < 4 * sigma[0]
    # The cosine is flat there: a rate known to 1 % leaves 8 degrees.
    assert result.sigma > 2 * sigma[0] / horizontal_earth_rate(LATITUDE)


def test_four_gyros_halve_the_sigma_and_stay_honest():
    off, gain = [], []
    for seed in range(8):
        runs = [built(100 * seed + k, "maytag4", 0.4) for k in range(4)]
        result = [find_north([record_of(r)], LATITUDE, "maytag4", settle=1.0) for r in runs]
        azimuth, sigma = fuse_azimuths([(f.posterior, f.horizontal_rate) for f in result])
        off.append((azimuth - 0.4) / sigma)
        gain.append(np.mean([f.sigma for f in result]) / sigma)
    assert np.median(gain) == pytest.approx(2, rel=0.15)
    assert np.sqrt(np.mean(np.square(off))) < 1.7


def test_one_minute_of_a_noisy_gyro_says_that_it_does_not_know():
    run = built(3, "maytag4", 1.0, sensor=Sensor(1.0, 20, 100), stops=8, stop=6.0)
    result = find_north([record_of(run)], LATITUDE, "maytag4")
    assert result.sigma > np.radians(45)
    assert any("does not determine north" in text for text in result.warnings)


def test_the_density_of_a_record_without_earth_rate_in_it_is_flat():
    run = built(4, "maytag4", 1.0, sensor=Sensor(50.0, 0, 0))
    result = find_north([record_of(run)], LATITUDE, "maytag4")
    # Uniform over the circle: pi/sqrt(3).
    assert summarise_azimuth(result.posterior)[1] == pytest.approx(np.pi / np.sqrt(3), rel=0.1)


@pytest.mark.parametrize(
    "latitude, words",
    [(np.radians(91), "out of range"), (np.radians(88), "too close to the pole"), (np.nan, "out of range")],
)
def test_impossible_latitudes_are_refused(latitude, words):
    with pytest.raises(InputError, match=words):
        horizontal_earth_rate(latitude)


@pytest.mark.parametrize(
    "change, error, words",
    [
        ({"stops": 2}, InputError, "2 stops are too few"),
        ({"angles": [0.0, np.pi / 2]}, InputError, "180 degrees apart"),
        ({"method": "maytag4"}, InputError, "every 90 degrees"),
        ({"method": "maytag4", "angles": [0.0, np.pi, 1.5 * np.pi]}, InputError, "every 90 degrees"),
        ({"method": "carousel"}, InputError, "turns; a carousel needs at least 2"),
        ({"method": "north"}, InputError, "method 'north' is unknown"),
        ({"constant": True}, CalibrationError, "never changes"),
    ],
    ids=[
        "too few",
        "wrong angles",
        "no cross stops",
        "half a cross",
        "no turns",
        "no method",
        "constant",
    ],
)
def test_unusable_records_are_refused_with_a_reason(change, error, words):
    rng = np.random.default_rng(0)
    angles = np.resize(change.get("angles", [0.0, np.pi]), change.get("stops", 4))
    run = maytag(TACTICAL.error(2000, DT, rng), DT, 0.0, LATITUDE, list(angles), 10.0, 2.0)
    rate = run.rate * 0 if change.get("constant") else run.rate
    with pytest.raises(error, match=words):
        find_north([AxisRecord(run.t, rate, table_of(run))], LATITUDE, change.get("method", "maytag"))


@pytest.mark.parametrize("late", [-1e5, 1e5])
def test_a_carousel_on_another_clock_than_the_node_is_refused(late):
    run = carousel(TACTICAL.error(3700, DT, np.random.default_rng(0)), DT, 1.0, LATITUDE, 30.0, 360.0)
    table = TableMotion(run.table_t + late, run.table_angle, run.table_moving)
    with pytest.raises(InputError, match="no time in common"):
        find_north([AxisRecord(run.t, run.rate, table)], LATITUDE, "carousel")


@pytest.mark.parametrize(
    "common, words", [(99, "no time in common"), (100, "turns; a carousel needs at least 2")]
)
def test_a_hundred_samples_are_the_least_that_carousel_and_node_must_share(common, words):
    """The first and last rows of the table coincide with samples of the node, which count as shared."""
    run = carousel(TACTICAL.error(3700, DT, np.random.default_rng(0)), DT, 1.0, LATITUDE, 30.0, 360.0)
    ends = run.t[[500, 500 + common - 1]]
    table = TableMotion(ends, np.array([0.0, 1.0]), np.array([True, True]))
    with pytest.raises(InputError, match=words):
        find_north([AxisRecord(run.t, run.rate, table)], LATITUDE, "carousel")


@pytest.mark.parametrize("count, words", [(99, "99 samples; record for some"), (100, "too few|no stop")])
def test_a_hundred_samples_are_the_least_of_a_record(count, words):
    run = maytag(
        TACTICAL.error(2000, DT, np.random.default_rng(0)), DT, 0.0, LATITUDE, [0.0, np.pi], 10.0, 2.0
    )
    with pytest.raises(InputError, match=words):
        find_north([AxisRecord(run.t[:count], run.rate[:count], table_of(run))], LATITUDE, "maytag")
