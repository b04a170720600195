"""Records as laboratories make them: rounded, at any rate, with one disturbed pose, with a wrong axis."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from generators.poses import GRAVITY, Errors, carry
from hubodo.errors import CalibrationError, HubodoError, InputError
from hubodo.sensors.imu.calibrate import calibrate_imu, estimate_static_bias
from hubodo.sensors.imu.quantisation import find_quantisation_steps, undithered_sigma
from hubodo.sensors.imu.standstills import find_standstills
from repetitions import first_and_more

ACCEL = Errors((0.2, -0.3, 0.1), (0.01, -0.02, 0.005))
"""Its matrix is diagonal, so it is symmetric as the convention demands."""


def calibrate(data, **options):
    return calibrate_imu(data.t, data.gyro, data.accel, gravity=GRAVITY, **options)


@pytest.mark.parametrize("digits", first_and_more(4, 3, 8, 10))
def test_sigmas_of_accelerometers_without_noise_cover_the_rounding(digits):
    pulls = []
    for seed in range(4):
        rng = np.random.default_rng([3302, digits, seed])
        data = carry(rng, Errors(), ACCEL, poses=16, dt=0.05, standstill_s=3.0, turn=2.0, accel_noise=0.0)
        result = calibrate_imu(data.t, data.gyro, np.round(data.accel, digits), gravity=GRAVITY)
        assert len(result.standstills) == 16
        error = np.append(result.accel.triad.bias - ACCEL.b, np.diag(result.accel.triad.matrix) - 1 - ACCEL.e)
        pulls.append(error / result.accel.sigma[[0, 1, 2, 3, 7, 11]])
    # If nine of ten errors are within 1.96 sigma, 18 or more of 24 are with a probability above 0.999.
    assert np.sum(np.abs(pulls) < 1.96) >= 18 and np.sqrt(np.mean(np.square(pulls))) < 1.6


@pytest.mark.parametrize("dither", [0.0, 0.2, 0.4, 1.0])
def test_the_error_of_a_mean_after_a_quantiser_is_as_widrow_has_it(dither):
    rng, step = np.random.default_rng(5), 0.03
    truth = rng.uniform(-5, 5, (4000, 1))
    samples = step * np.round((truth + dither * step * rng.standard_normal((4000, 200))) / step)
    scatter = np.sqrt(samples.var(axis=1).mean())
    common = undithered_sigma(np.array([scatter]), np.array([step]))[0]
    expected = np.hypot(common, scatter / np.sqrt(200))
    assert np.std(samples.mean(axis=1) - truth[:, 0]) == pytest.approx(expected, rel=0.15)


def test_steps_are_found_in_counts_decimals_and_single_precision_but_not_in_other_numbers():
    rng = np.random.default_rng(6)
    sparse = rng.uniform(-10, 10, 24)
    columns = [np.round(sparse, 4), np.round(sparse, 3) * 9.80665, np.float32(sparse), sparse]
    steps = find_quantisation_steps(np.column_stack(columns))
    assert steps[:2] == pytest.approx([1e-4, 9.80665e-3])
    assert steps[2] == pytest.approx(np.spacing(np.float32(9.0))) and steps[3] == 0.0
    counts = 0.00239 * np.round(rng.uniform(-10, 10, (3000, 1)) / 0.00239)
    assert find_quantisation_steps(counts) == pytest.approx([0.00239])


@pytest.mark.parametrize("rate_hz", [5, 10, 1000])
def test_standstills_are_those_simulated_at_any_rate(rate_hz):
    data = carry(np.random.default_rng(7), Errors(), ACCEL, poses=10, dt=1 / rate_hz, turn=2.4)
    standstills = find_standstills(data.t, data.gyro, data.accel)
    assert len(standstills) == 10
    # If the end of a turn shows in the mean of a window of 0.5 s, this window and the next one are removed.
    assert np.abs(standstills.t[:, 0] - np.arange(10) * 8.4).max() < 1.2


def test_a_knocked_pose_is_named_and_left_out():
    data = carry(np.random.default_rng(8), Errors(), ACCEL, poses=20, dt=0.04)
    start = round(8 * 8.5 / 0.04)
    data.accel[start : start + 150] *= 1.005
    result = calibrate(data)
    assert len(result.standstills) == 19
    (line,) = [note for note in result.notes if "rejected" in note]
    assert "68.2" in line and "gravity is +0.0463" in line and "4.7 mg" in line
    assert np.abs(result.accel.triad.bias - ACCEL.b).max() < 4 * result.accel.sigma[:3].max() < 0.01


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda gyro, accel: (gyro * [1, -1, 1], accel), "if gyro y is reversed"),
        (lambda gyro, accel: (gyro, accel * [1, 1, -1]), "if accelerometer z is reversed"),
        (lambda gyro, accel: (-gyro, accel), "if gyro x and y and z are reversed"),
        (lambda gyro, accel: (gyro[:, [1, 0, 2]], accel), "gx, gy, gz are in truth gy, gx, gz"),
        (lambda gyro, accel: (gyro, np.where(accel == accel[900], np.nan, accel)), "the first at 36 s"),
    ],
    ids=["gyro y", "accel z", "left-handed", "x for y", "not a number"],
)
def test_a_wrong_axis_is_named(change, words):
    data = carry(np.random.default_rng(9), Errors(), ACCEL, poses=12, dt=0.04)
    with pytest.raises(HubodoError, match=words):
        calibrate_imu(data.t, *change(data.gyro, data.accel), gravity=GRAVITY)


@pytest.mark.parametrize("seeds", first_and_more(range(2), range(3)), ids=str)
def test_small_turns_in_one_direction_do_not_move_the_bias(seeds):
    """Each smooth turn of 15 degrees begins so gently that its first 0.3 s look like a standstill."""
    pulls = []
    for seed in seeds:
        rng = np.random.default_rng([3305, seed])
        angles = np.c_[rng.uniform(-5, 5, (24, 2)), np.arange(24) * 15.0]
        data = carry(
            rng, Errors(), ACCEL, dt=0.02, attitudes=Rotation.from_euler("zyx", angles, degrees=True)
        )
        result = calibrate(data)
        error = np.append(result.gyro.triad.bias, np.diag(result.gyro.triad.matrix) - 1)
        pulls.append(error / np.sqrt(np.diag(result.gyro.covariance))[[0, 1, 2, 3, 7, 11]])
    assert np.abs(pulls).max() < 3.6


def test_turns_with_missing_samples_are_named_and_left_out():
    data = carry(np.random.default_rng(15), Errors(), ACCEL, poses=14, dt=0.02)
    missing = np.zeros(len(data.t), bool)
    for turn in (3, 6):
        missing[round((turn * 8.5 + 7.0) / 0.02) :][:20] = True
    result = calibrate_imu(data.t[~missing], data.gyro[~missing], data.accel[~missing], gravity=GRAVITY)
    lines = [note for note in result.notes if "samples are missing for 0.42 s" in note]
    assert [line.partition(":")[0] for line in lines] == ["turn 4", "turn 7"]
    assert len(result.gyro.turns.used) == 11


def test_five_turns_that_fit_by_chance_have_the_sigma_of_the_noise():
    pulls = []
    for seed in (1, 3, 4):
        data = carry(np.random.default_rng([3306, seed]), Errors(), ACCEL, poses=24, dt=0.04)
        result = calibrate_imu(data.t, np.clip(data.gyro, -1.0, 1.0), data.accel, gravity=GRAVITY)
        assert len(result.gyro.turns.used) <= 6
        error = (result.gyro.triad.matrix - np.eye(3)).ravel()[result.gyro.is_observable]
        pulls.extend(error / np.sqrt(np.diag(result.gyro.covariance))[3:][result.gyro.is_observable])
    assert len(pulls) >= 18 and np.sqrt(np.mean(np.square(pulls))) < 1.5


def test_poses_beyond_the_range_of_an_accelerometer_are_named_and_left_out():
    data = carry(np.random.default_rng(17), Errors(), ACCEL, dt=0.02)
    result = calibrate_imu(data.t, data.gyro, np.clip(data.accel, -9.0, 9.0), gravity=GRAVITY)
    clipped = [note for note in result.notes if "is clipped at" in note]
    assert len(clipped) + len(result.standstills) <= 24 and len(result.standstills) >= 15
    error = np.append(result.accel.triad.bias - ACCEL.b, result.accel.triad.scale_error - ACCEL.e)
    assert np.abs(error / result.accel.sigma[[0, 1, 2, 3, 7, 11]]).max() < 4


@pytest.mark.parametrize("seeds", first_and_more(range(1), range(2)), ids=str)
@pytest.mark.parametrize("power, name", [(2, "quadratic"), (3, "cubic")])
def test_nonlinear_accelerometers_are_named_and_bias_and_scale_stay_within_sigma(power, name, seeds):
    pulls = []
    for seed in seeds:
        data = carry(np.random.default_rng([3307, seed]), Errors(), ACCEL, dt=0.04)
        accel = data.accel + 0.005 * GRAVITY * (data.accel / GRAVITY) ** power * [1.0, -1.0, 0.5]
        result = calibrate_imu(data.t, data.gyro, accel, gravity=GRAVITY)
        assert any(f"{name} terms x +" in note and "mg at 1 g" in note for note in result.notes)
        assert result.accel.exponents == (power,)
        terms = (result.accel.nonlinear - [0.005, -0.005, 0.0025]) / result.accel.nonlinear_sigma
        error = np.append(result.accel.triad.bias - ACCEL.b, result.accel.triad.scale_error - ACCEL.e)
        pulls.extend([*terms, *(error / result.accel.sigma[[0, 1, 2, 3, 7, 11]])])
        assert result.accel_held_out.rms < 0.005
    assert np.abs(pulls).max() < 4 and np.sqrt(np.mean(np.square(pulls))) < 1.6


def test_accelerometers_whose_bias_drifts_are_named():
    data = carry(np.random.default_rng(18), Errors(), ACCEL, dt=0.04)
    drift = 0.05 * (data.t / data.t[-1] - 0.5)[:, None]
    result = calibrate_imu(data.t, data.gyro, data.accel + drift, gravity=GRAVITY)
    assert any("times as much as the noise of the standstills" in note for note in result.notes)
    error = np.append(result.accel.triad.bias - ACCEL.b, result.accel.triad.scale_error - ACCEL.e)
    assert np.abs(error / result.accel.sigma[[0, 1, 2, 3, 7, 11]]).max() < 4


@pytest.mark.parametrize("seeds", first_and_more(range(1), range(2)), ids=str)
@pytest.mark.parametrize("kind, share", [("asymmetry", 0.005), ("cubic", -0.01)])
def test_nonlinear_gyros_are_named_and_scale_and_angles_stay_within_sigma(kind, share, seeds):
    pulls = []
    for seed in seeds:
        data = carry(np.random.default_rng([3308, seed]), Errors(), ACCEL, dt=0.02)
        term = np.abs(data.true_rate) if kind == "asymmetry" else data.true_rate**3
        result = calibrate_imu(data.t, data.gyro + share * term, data.accel, gravity=GRAVITY)
        (line,) = [note for note in result.notes if "the gyros are nonlinear" in note]
        assert f"{kind} x {100 * share:+.1g}"[:-1] in line and len(result.gyro.turns.used) == 23
        sigma = np.sqrt(np.diag(result.gyro.covariance))
        terms = (result.gyro.turns.terms) / result.gyro.turns.term_sigma
        pulls.extend([*terms, *((result.gyro.triad.matrix - np.eye(3)).ravel() / sigma[3:])])
        assert np.degrees(result.gyro.held_out.error.max()) < 0.5
    assert np.abs(pulls).max() < 4 and np.sqrt(np.mean(np.square(pulls))) < 1.5


def test_correlated_standstills_widen_the_sigma_of_the_bias():
    """Means of neighbouring standstills with correlation 0.5: the mean has sqrt(3) times the white sigma."""
    rng = np.random.default_rng(16)
    pulls, white = [], []
    for _ in range(200):
        rate = lfilter([np.sqrt(0.75)], [1, -0.5], rng.standard_normal((40, 3)), axis=0)
        bias, covariance, *_ = estimate_static_bias(rate, np.full((40, 3), 0.1), np.ones((40, 3)))
        pulls.append(bias / np.sqrt(np.diag(covariance)))
        white.append(bias / (rate.std(axis=0, ddof=1) / np.sqrt(40)))
    assert np.std(pulls) < 1.25 < 1.5 < np.std(white)


def test_a_calibration_that_makes_other_poses_worse_is_refused():
    data = carry(np.random.default_rng(9), Errors(), Errors((1e-4, 0, 0)), poses=14, dt=0.04)
    with pytest.raises(CalibrationError, match="makes the length of gravity worse"):
        calibrate(data)


@pytest.mark.parametrize("latitude", first_and_more(None, 1.0))
def test_earth_rate_in_slow_turns_is_no_scale_error(latitude):
    pulls, errors = [], []
    for seed in range(3):
        rng = np.random.default_rng([3304, seed])
        data = carry(
            rng, Errors(), ACCEL, poses=12, dt=0.1, turn=30.0, gyro_noise=2e-4, latitude=1.0, standstill_s=8.0
        )
        result = calibrate(data, latitude=latitude)
        errors.append(np.diag(result.gyro.triad.matrix) - 1)
        pulls.append(errors[-1] / np.sqrt(np.diag(result.gyro.covariance))[[3, 7, 11]])
    # Without a model of Earth rate the error is 0.2 %.
    assert np.sqrt(np.mean(np.square(errors))) < 4e-4 and np.sqrt(np.mean(np.square(pulls))) < 1.8


@pytest.mark.parametrize(
    "given_deg, words",
    [
        (-50.0, "sign is reversed"),
        (np.radians(50.0), "given in radians"),
        (8.5, r"50\.. ± .* where 8\.5 is given"),
    ],
)
def test_a_wrong_latitude_is_named_where_gyros_measure_earth_rate(given_deg, words):
    rng = np.random.default_rng(11)
    small = Errors((1e-6, -2e-6, 1e-6), (0.01, -0.01, 0.005))
    data = carry(rng, small, ACCEL, poses=16, dt=0.05, gyro_noise=1e-6, latitude=np.radians(50.0))
    with pytest.raises(InputError, match=words):
        calibrate(data, latitude=np.radians(given_deg))
    if given_deg < 0:
        assert "Earth rate" in calibrate(data, latitude=np.radians(50.0)).gyro.method


def test_a_wrong_latitude_is_named_where_turns_measure_earth_rate():
    rng = np.random.default_rng(12)
    data = carry(rng, Errors(), ACCEL, poses=12, dt=0.1, turn=30.0, gyro_noise=2e-4, latitude=0.35)
    with pytest.raises(InputError, match=r"horizontal Earth rate of 12.* where 70 is given"):
        calibrate(data, latitude=np.radians(70.0))
