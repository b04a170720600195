"""Selection of the gyro reference (Earth rate, rate table or turns), its thresholds and its results."""

from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import polar
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from scipy.stats import f as f_distribution

from hubodo.calibration.triad import Triad
from hubodo.errors import CalibrationError, InputError
from hubodo.sensors.imu import accel_poses, vector_references
from hubodo.sensors.imu import calibrate as room
from hubodo.sensors.imu.calibrate import calibrate_imu, estimate_static_bias
from hubodo.sensors.imu.result import ImuCalibration, TriadCalibration
from hubodo.sensors.imu.standstills import Standstills

EARTH = 2 * np.pi / 86164.0905
BIAS = np.array([0.02, -0.05, 0.01])
G = np.array([[1e-4, 2e-4, 0.0], [0.0, -2e-4, 1e-4], [1e-4, 0.0, -1e-4]])


def rests_in(count, sigma=1e-6, g=0.0, noise=1e-6, seed=1, offset=1.0):
    """Return rates, their sigmas and forces of rests in directions that differ by `offset`."""
    rng = np.random.default_rng(seed)
    force = 9.81 * (np.array([0.0, 0.0, 1.0]) + offset * rng.standard_normal((count, 3)))
    rate = BIAS + g * force @ G.T + noise * rng.standard_normal((count, 3))
    return rate, np.full((count, 3), sigma) * np.array([1.0, 2.0, 3.0]), force


@pytest.mark.parametrize("sigma", [1e-7, 1e-2])
@pytest.mark.parametrize("count", [3, 5, 7])
def test_of_few_rests_the_bias_is_their_mean_and_as_uncertain_as_they_scatter_or_are_known(count, sigma):
    rate, known, force = rests_in(count, sigma, g=1.0)
    bias, covariance, g, g_sigma = estimate_static_bias(rate, known, force)
    assert g is None and g_sigma is None
    assert bias == pytest.approx(rate.mean(axis=0))
    scatter, own = rate.var(axis=0, ddof=1) / count, known[0] ** 2 / count
    assert (scatter > own).all() == (sigma < 1e-5)
    assert covariance / own == pytest.approx(np.diag(np.maximum(scatter, own)) / own, rel=1e-9)


def test_two_rests_are_as_uncertain_as_each_is_known():
    """Two standstills do not determine a scatter."""
    rate, known, force = rests_in(2, 1e-7, g=1.0)
    covariance = estimate_static_bias(rate, known, force)[1]
    assert covariance * 1e14 == pytest.approx(np.diag([1.0, 4.0, 9.0]) / 2)


@pytest.mark.parametrize("sigma", [1e-8, 1e-4])
@pytest.mark.parametrize("count", [8, 20])
def test_from_eight_rests_on_what_force_does_is_solved_for_by_least_squares(count, sigma):
    rate, known, force = rests_in(count, sigma, g=1.0)
    bias, covariance, g, g_sigma = estimate_static_bias(rate, known, force)
    for k in range(3):
        columns = np.column_stack([np.ones(count), force])
        solved, squares, _, _ = np.linalg.lstsq(columns, rate[:, k], rcond=None)
        variance = max(squares[0] / (count - 4), known[0, k] ** 2)
        spread = np.sqrt(variance * np.diag(np.linalg.inv(columns.T @ columns)))
        assert np.append(bias[k], g[k]) == pytest.approx(solved, rel=1e-9, abs=1e-12)
        result = np.append(np.sqrt(covariance[k, k]), g_sigma[k])
        assert result == pytest.approx(spread, rel=1e-6, abs=0.0)
    assert np.count_nonzero(covariance) == 3


@pytest.mark.parametrize("p, believed", [(0.9e-3, True), (1.1e-3, False)])
def test_a_g_sensitivity_is_accepted_below_a_p_value_of_one_in_a_thousand(p, believed):
    """F-test of nine slopes of three gyros together."""
    count = 14
    noise = np.random.default_rng(3).standard_normal((count, 3))
    _, known, force = rests_in(count)
    columns = np.column_stack([np.ones(count), force])
    fitted = columns @ np.linalg.lstsq(columns, noise, rcond=None)[0]
    left, explained = noise - fitted, fitted - fitted.mean(axis=0)
    wanted = f_distribution.isf(p, 9, 3 * (count - 4)) * 9 / (3 * (count - 4))
    explained *= np.sqrt(wanted * (left**2).sum() / (explained**2).sum())
    assert (estimate_static_bias(1e-6 * (left + explained), known, force)[2] is not None) == believed


@pytest.mark.parametrize("condition, reported", [(29.5, True), (30.5, False)])
def test_standstills_in_similar_attitudes_do_not_show_a_g_sensitivity(condition, reported):
    """No g-sensitivity is estimated from a condition number of 30 on."""

    def condition_of(offset):
        columns = np.column_stack([np.ones(12), rests_in(12, offset=offset)[2]])
        return np.linalg.cond(columns / np.sqrt((columns**2).sum(axis=0)))

    offset = brentq(lambda offset: condition_of(offset) - condition, 0.03, 0.5)
    result = estimate_static_bias(*rests_in(12, 1e-8, g=1.0, noise=1e-9, offset=offset))[2]
    assert (result is not None) == reported


def standstills(count=9, sigma=1e-7, loud=1.0, seconds=12.0):
    """Return standstills as `find_standstills` does; loud: noise factor of the last one."""
    rate, _, force = rests_in(count)
    gyro_sigma = np.full((count, 3), sigma) * np.sqrt([0.5, 1.0, 1.5])
    gyro_sigma[-1] *= loud
    start = 100 * np.arange(count)
    t = np.column_stack([20.0 * np.arange(count), 20.0 * np.arange(count) + seconds])
    return Standstills(start, start + 50, t, rate, force, gyro_sigma, np.full((count, 3), 1e-3))


ACCEL = SimpleNamespace(triad=Triad(np.zeros(3), np.eye(3)), correct=lambda raw: raw)


def replace_part(monkeypatch, name, built):
    for module in (room, accel_poses, vector_references):
        if hasattr(module, name):
            monkeypatch.setattr(module, name, built)


@pytest.fixture
def parts(monkeypatch):
    """Replace the parts by stand-ins that record their arguments and return given results."""
    observed = SimpleNamespace(follows=None, earth=None, measured=None)

    def collect_turns(t, gyro, follows, standstills, force):
        observed.follows, observed.force = follows, force
        return SimpleNamespace(select=lambda used: "turns")

    def refuse(*_, **__):
        raise CalibrationError("not seen")

    def scalar_calibration(measured, reference, sigma, **options):
        observed.measured, observed.reference, observed.sigma = measured, reference, sigma
        triad = Triad(BIAS, np.eye(3) + 0.01 * np.arange(9.0).reshape(3, 3))
        full = np.diag(np.arange(1.0, 13.0))
        return SimpleNamespace(triad=triad, full_covariance=full, sigma=np.sqrt(np.diag(full)))

    replace_part(monkeypatch, "collect_turns", collect_turns)
    replace_part(monkeypatch, "calibrate_from_turns", refuse)
    replace_part(monkeypatch, "calibrate_with_terms", refuse)
    replace_part(monkeypatch, "estimate_earth_in_turns", refuse)
    replace_part(monkeypatch, "fit_scalar_calibration", scalar_calibration)
    replace_part(monkeypatch, "align_by_earth_rate", refuse)
    replace_part(monkeypatch, "check_latitude", lambda *_: None)
    observed.set = partial(replace_part, monkeypatch)
    return observed


def gyro_of(standstills, latitude=None, notes=None):
    every = np.arange(30.0).reshape(10, 3)
    return room._calibrate_gyro(
        np.arange(10.0),
        np.zeros((10, 3)),
        every,
        standstills,
        ACCEL,
        latitude,
        [] if notes is None else notes,
        np.zeros(3),
    )


@pytest.mark.parametrize("share, serves", [(0.0995, True), (0.1005, False)])
@pytest.mark.parametrize("loud", [1.0, 4.0])
def test_earth_rate_is_used_if_every_standstill_has_ten_times_lower_noise(parts, share, serves, loud):
    notes = []
    result = gyro_of(standstills(sigma=share * EARTH / loud, loud=loud), 0.8, notes)
    assert ("Earth rate in 9 standstills" in result.method) == serves
    needed = [note for note in notes if "too noisy" in note]
    assert len(needed) == (not serves)
    assert "Earth rate" not in gyro_of(standstills(sigma=1e-9)).method


def test_for_noisy_gyros_the_standstill_needed_for_earth_rate_is_reported(parts):
    """The noise of a mean falls with the root of its duration: ten times the noise, 100 times as long."""
    notes = []
    gyro_of(standstills(sigma=EARTH, seconds=12.0), 0.8, notes)
    assert "standstills of 1200 s" in notes[0]


def test_without_turns_only_the_bias_is_estimated_with_earth_rate_in_its_sigma(parts):
    """Earth rate points in another direction in each pose, so each axis has a third of its square."""
    at, notes = standstills(count=5), []
    result = gyro_of(at, notes=notes)
    bias, covariance, *_ = estimate_static_bias(at.gyro, at.gyro_sigma, at.accel)
    assert result.triad.bias == pytest.approx(bias) and result.is_observable.tolist() == 9 * [False]
    expected = np.zeros((12, 12))
    expected[:3, :3] = covariance + np.eye(3) * EARTH**2 / 15
    assert result.covariance * 1e12 == pytest.approx(expected * 1e12)
    assert notes == ["gyro scale and misalignments left out: not seen"]
    assert "bias alone, from 5 standstills" in result.method


@pytest.mark.parametrize("g", [0.0, 1.0])
def test_bias_and_g_sensitivity_are_subtracted_sample_by_sample_before_turns(parts, g):
    at = standstills(count=12)
    rate, _, force = rests_in(12, g=g, noise=1e-9)
    at = Standstills(at.start, at.end, at.t, rate, force, 1e-3 * at.gyro_sigma, at.accel_sigma)
    result = gyro_of(at)
    every = np.arange(30.0).reshape(10, 3)
    assert (result.g_sensitivity is not None) == bool(g)
    assert np.broadcast_to(parts.follows, (10, 3)) == pytest.approx(BIAS + g * every @ G.T, abs=1e-7)


def test_turns_move_the_bias_and_their_covariance_holds_the_accelerometers_frame_too(parts):
    observed = np.ones(9, bool)
    turns = SimpleNamespace(
        matrix=2 * np.eye(3),
        bias_change=np.array([1e-3, 2e-3, 3e-3]),
        covariance=np.eye(12),
        is_observable=observed,
        used=np.arange(4),
        dropped=("one was dropped",),
        deficit="",
    )
    sigmas, notes = [], []
    parts.set("calibrate_with_terms", lambda every, sigma: sigmas.append(sigma) or (every, turns, ()))
    parts.set("accel_frame_covariance", lambda *_: 3 * np.eye(12))
    parts.set("cross_validate_turns", lambda turns, sigma: (turns, sigma))
    at = standstills(count=5)
    result = gyro_of(at, notes=notes)
    assert result.triad.bias == pytest.approx(at.gyro.mean(axis=0) + turns.bias_change)
    assert result.covariance == pytest.approx(4 * np.eye(12)) and notes[0] == "one was dropped"
    assert len(notes) == 2 and "relative to the clock of the log" in notes[1]
    _, covariance, *_ = estimate_static_bias(at.gyro, at.gyro_sigma, at.accel)
    wanted = np.sqrt(np.diag(covariance) + EARTH**2 / 15)
    assert sigmas[0] == pytest.approx(wanted, rel=1e-7, abs=0.0)
    assert result.held_out[0] == "turns" and result.held_out[1] == pytest.approx(wanted, rel=1e-7, abs=0.0)
    assert "all six misalignments" in result.method
    observed[4], turns.deficit = False, "axis y"
    part = gyro_of(at, notes=notes)
    assert "what they show" in part.method and "all six" not in part.method and "left out: axis y" in notes


def test_by_earth_rate_the_covariance_takes_in_the_angle_between_both_triads(parts):
    angle, spread = np.array([0.02, -0.01, 0.03]), np.diag([1e-2, 4e-2, 9e-2])
    reported = []

    def align(force, rate, noise, latitude):
        reported.append((noise, latitude))
        return SimpleNamespace(angle=angle, covariance=spread)

    at, notes = standstills(), []
    plain = vector_references.calibrate_by_earth_rate(at, at.accel, 0.8, notes)
    assert parts.measured is at.gyro and parts.reference == pytest.approx(EARTH)
    assert plain.covariance == pytest.approx(
        np.diag(np.arange(1.0, 13.0))
    ) and plain.is_observable.tolist() == 9 * [True]
    assert "symmetric convention alone" in notes[0]
    parts.set("align_by_earth_rate", align)
    result = vector_references.calibrate_by_earth_rate(at, at.accel, 0.8, notes)
    assert reported[0][0] == pytest.approx(np.sqrt((at.gyro_sigma**2).mean(axis=1)), abs=0.0)

    def matrix(more):
        both = Rotation.from_rotvec(more) * Rotation.from_rotvec(angle)
        return (plain.triad.matrix @ both.as_matrix().T).ravel()

    assert result.triad.matrix.ravel() == pytest.approx(
        matrix(np.zeros(3))
    ) and result.is_observable.tolist() == 9 * [True]
    slope = np.array([(matrix(1e-4 * e) - matrix(-1e-4 * e)) / 2e-4 for e in np.eye(3)]).T
    expected = np.diag(np.arange(1.0, 13.0))
    expected[3:, 3:] += slope @ spread @ slope.T
    assert result.covariance == pytest.approx(expected, abs=1e-5)


def test_a_table_gives_sizes_and_turns_the_nearest_rotation_to_their_frame(parts):
    steady, sigma = np.ones((9, 3)), np.full((9, 3), 1e-4)
    asked = []
    parts.set("find_steady_turns", lambda t, gyro, rate, bias: asked.append(bias) or (steady, sigma))
    at, notes = standstills(), []

    def by_table():
        return vector_references.calibrate_by_table(np.zeros(4), np.zeros((4, 3)), at, at.accel, 1.5, notes)

    plain = by_table()
    assert "symmetric convention alone" in notes[0] and plain.turns is None
    assert parts.sigma == pytest.approx(np.sqrt(1e-8 + EARTH**2 / 3), rel=1e-12)
    assert parts.measured is steady and parts.reference == 1.5 and plain.is_observable.tolist() == 9 * [True]
    assert asked[0] == pytest.approx(at.gyro.mean(axis=0))
    turns = SimpleNamespace(
        matrix=plain.triad.matrix @ (Rotation.from_rotvec([0.1, 0.2, 0.3]).as_matrix() + 0.01),
        covariance=np.arange(144.0).reshape(12, 12),
        deficit="",
    )
    sigmas = []
    parts.set("calibrate_from_turns", lambda _, sigma: sigmas.append(sigma) or turns)
    result = by_table()
    assert sigmas[0] == pytest.approx(np.sqrt([1.0, 2.0, 3.0])) and result.is_observable.tolist() == 9 * [
        True
    ]
    rotation, _ = polar(np.linalg.inv(plain.triad.matrix) @ turns.matrix)
    assert result.triad.matrix == pytest.approx(plain.triad.matrix @ rotation)
    more = result.covariance - plain.covariance
    assert more[3:, 3:] == pytest.approx(turns.covariance[3:, 3:]) and not more[:3].any()
    assert result.turns is turns and result.triad.bias == pytest.approx(BIAS)
    turns.deficit = "axis y"
    assert by_table().turns is None and "axis y" in notes[-1]


@pytest.mark.parametrize("sufficient", [True, False])
def test_notes_start_with_the_methods_of_both_triads_and_unobservable_parameters(monkeypatch, sufficient):
    at = standstills()
    at = Standstills(
        at.start, at.end, at.t, at.gyro, at.accel, at.gyro_sigma, at.accel_sigma, ("a rest crept",)
    )
    poses = SimpleNamespace(is_sufficient=sufficient, describe_deficit=lambda name: f"{name} lacks a pose")
    given = []

    def solve(_, gravity, convention, pose_terms):
        assert pose_terms == ()
        given.extend([gravity, convention])
        return SimpleNamespace(poses=poses, correct=lambda raw: raw, exponents=())

    replace_part(monkeypatch, "find_standstills", lambda *_, **__: at)
    replace_part(monkeypatch, "drop_outlier_poses", lambda standstills, _: standstills)
    replace_part(monkeypatch, "collect_turns", lambda *_: None)
    replace_part(monkeypatch, "check_axis_signs", lambda _: None)
    replace_part(monkeypatch, "fit_accelerometers", solve)
    replace_part(monkeypatch, "describe_accelerometers", lambda _: ["the accelerometers are bent"])
    replace_part(monkeypatch, "cross_validate_accel", lambda *_: None)
    replace_part(monkeypatch, "_calibrate_gyro", lambda *_: SimpleNamespace(method="some turns"))
    result = calibrate_imu(np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3)), convention="symmetric")
    first, second, *others = result.notes
    assert (
        "symmetric convention, from the norm of gravity in 9 standstills" in first
        and second == "gyros: some turns"
    )
    assert others == ([] if sufficient else ["left out: accel lacks a pose"]) + [
        "a rest crept",
        "the accelerometers are bent",
    ]
    assert given == [9.80665, "symmetric"]


class Passed(Exception):
    pass


@pytest.mark.parametrize(
    "gravity, degrees, words",
    [
        (9.69, None, "gravity"),
        (9.91, None, "gravity"),
        (9.76, 90.0, ""),
        (9.84, -90.0, ""),
        (9.8, 90.1, "latitude"),
        (9.8, -90.1, "latitude"),
    ],
)
def test_places_on_earth_are_accepted_and_no_others(monkeypatch, gravity, degrees, words):
    def passed(*_, **__):
        raise Passed

    replace_part(monkeypatch, "find_standstills", passed)
    latitude = None if degrees is None else np.radians(degrees)
    with pytest.raises(InputError if words else Passed, match=words or None):
        calibrate_imu(np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3)), gravity=gravity, latitude=latitude)


def test_the_file_names_each_element_of_the_answer_to_force_by_gyro_and_axis():
    accel = SimpleNamespace(
        triad=Triad(np.zeros(3), np.eye(3)), sigma=np.ones(12), is_observable=np.ones(12, bool)
    )
    g = np.arange(1.0, 10.0).reshape(3, 3)
    gyro = TriadCalibration(
        Triad(BIAS, np.eye(3)), np.diag(np.arange(1.0, 13.0) ** 2), np.zeros(9, bool), "", g, g / 10
    )
    result = ImuCalibration(standstills(), 9.81, accel, None, gyro, ()).effect_parameters()
    reported = {name: (q.value, q.sigma) for name, q in result["gyro_g_sensitivity"].items()}
    for i, row in enumerate("xyz"):
        for j, column in enumerate("xyz"):
            name = column if row == "z" else row + column
            assert reported[name] == pytest.approx((g[i, j], g[i, j] / 10))
    bias = result["gyro_bias"]
    assert [(bias[a].value, bias[a].sigma) for a in "xyz"] == [
        pytest.approx((b, s)) for b, s in zip(BIAS, (1.0, 2.0, 3.0), strict=True)
    ]
    assert "gyro_scale_factor" not in result
