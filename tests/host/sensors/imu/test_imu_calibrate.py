"""Calibration of both triads by turns, Earth rate or a rate table, and records that must be refused."""

import argparse
import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, sem

from generators.poses import GRAVITY, Errors, carry, laid_on_faces
from hubodo.calibration.file import read_calibration
from hubodo.calibration.triad import Triad, triad_from_effects
from hubodo.errors import CalibrationError, InputError
from hubodo.log.csv_table import write_table
from hubodo.recording import Table
from hubodo.sensors.imu.accel_frame import accel_frame_covariance
from hubodo.sensors.imu.calibrate import calibrate_imu
from hubodo.sensors.imu.earth_in_turns import estimate_earth_in_turns
from hubodo.sensors.imu.misalignment import align_by_earth_rate
from hubodo.sensors.imu.standstills import find_standstills, standard_error
from hubodo.sensors.imu.turn_calibration import calibrate_from_turns
from hubodo.sensors.imu.turns import Turns, collect_turns, propagate_gravity, propagate_gravity_jacobian
from hubodo.verbs import calibrate_imu as verb
from repetitions import first_and_more

GYRO = Errors(
    (0.02, -0.05, 0.01),
    (0.03, -0.02, 0.01),
    {"xz": 0.01, "xy": -0.02, "yz": 0.004, "yx": 0.015, "zy": -0.01, "zx": 0.006},
)
ACCEL = Errors((0.3, -0.5, 0.2), (0.01, -0.02, 0.015), {"xz": 0.004, "yz": -0.004, "zy": 0.006, "xy": -0.006})


def matrix(errors):
    return errors.measure(np.eye(3)).T - np.array(errors.b)[:, None]


def z_scores(triad, sigma, errors):
    truth = np.concatenate([errors.b, matrix(errors).ravel()])
    result = np.concatenate([triad.bias, triad.matrix.ravel()])
    return (result - truth) / sigma


@pytest.mark.parametrize("steps", [1, 2, 7, 200])
def test_the_derivatives_of_propagated_gravity_by_a_triad_equal_differences(steps):
    rng = np.random.default_rng(steps)
    change = 0.05 * rng.standard_normal((4, steps, 3))
    rate = np.cumsum(change, axis=1)
    start = rng.standard_normal((4, 3))
    start /= np.linalg.norm(start, axis=1)[:, None]
    turns = Turns(rate, change, np.full((4, steps), 0.01), start, start, np.arange(4), np.zeros(4, "U1"))
    at = np.concatenate([(np.eye(3) + 0.03 * rng.standard_normal((3, 3))).ravel(), rng.normal(0, 0.01, 3)])
    end, slopes = propagate_gravity_jacobian(turns, at[:9].reshape(3, 3), at[9:])
    np.testing.assert_array_equal(end, propagate_gravity(turns, at[:9].reshape(3, 3), at[9:]))
    for place, step in enumerate(1e-5 * np.eye(12)):
        there, back = (
            propagate_gravity(turns, (at + by)[:9].reshape(3, 3), (at + by)[9:]) for by in (step, -step)
        )
        off = np.abs(slopes[..., place] - (there - back) / 2e-5).max()
        assert off < 1e-4 * np.abs(slopes).max(), place


@pytest.mark.parametrize(
    ("seeds", "limit"),
    first_and_more((range(1, 4), 29.6), (range(4, 10), 37.4), (range(10, 16), 37.4)),
    ids=str,
)
def test_both_triads_are_recovered_from_standstills_and_turns_within_sigma(seeds, limit):
    z = []
    for seed in seeds:
        data = carry(np.random.default_rng(seed), GYRO, ACCEL)
        result = calibrate_imu(data.t, data.gyro, data.accel, gravity=GRAVITY)
        assert len(result.standstills) == 24
        z.append(
            np.append(
                z_scores(result.accel.triad, result.accel.sigma, ACCEL),
                z_scores(result.gyro.triad, np.sqrt(np.diag(result.gyro.covariance)), GYRO),
            )
        )
        assert result.accel_held_out.rms < 0.005 < 0.2 < result.accel_held_out.rms_before
        assert np.degrees(result.gyro.held_out.error.max()) < 0.5
        assert "turns between standstills" in result.gyro.method
    squares = np.square(z)
    # Of 24 sums of squares of Student's t with 32 degrees of freedom one exceeds it once in 1,000 runs.
    assert squares.sum(axis=0).max() < limit and 0.7 < np.sqrt(squares.mean()) < 1.2


def test_g_sensitivity_is_separated_from_bias_and_omitted_if_absent():
    g = np.array([[1e-4, 2e-4, 0], [0, -2e-4, 1e-4], [1e-4, 0, -1e-4]])
    rng = np.random.default_rng(4)
    data = carry(rng, GYRO, ACCEL, g_sensitivity=g)
    result = calibrate_imu(data.t, data.gyro, data.accel, gravity=GRAVITY)
    assert np.abs((result.gyro.g_sensitivity - g) / result.gyro.g_sensitivity_sigma).max() < 4
    assert np.abs(z_scores(result.gyro.triad, np.sqrt(np.diag(result.gyro.covariance)), GYRO)).max() < 4.2
    plain = carry(rng, GYRO, ACCEL)
    assert calibrate_imu(plain.t, plain.gyro, plain.accel, gravity=GRAVITY).gyro.g_sensitivity is None


def test_precise_gyros_are_calibrated_by_earth_rate_and_their_six_angles_by_the_angle_to_gravity():
    small = Errors((2e-6, -3e-6, 1e-6), (1e-3, -2e-3, 1e-3), GYRO.d)
    latitude = np.radians(50)
    rng = np.random.default_rng(6)
    data = carry(rng, small, ACCEL, poses=30, gyro_noise=1e-6, latitude=latitude)
    result = calibrate_imu(data.t, data.gyro, data.accel, gravity=GRAVITY, latitude=latitude)
    assert "Earth rate" in result.gyro.method and "angle between gravity and Earth rate" in result.gyro.method
    assert np.abs(z_scores(result.gyro.triad, np.sqrt(np.diag(result.gyro.covariance)), small)).max() < 4.2
    sigma = np.sqrt(np.diag(result.gyro.covariance))
    assert sigma[3:].max() < 0.003


def test_poses_unsuited_for_earth_rate_still_determine_the_gyro_bias():
    # In nine poses of the scalar method east lies along one axis of the node: the rows east x up are in one
    # plane.
    latitude = np.radians(50)
    rng = np.random.default_rng(7)
    attitudes = Rotation.from_rotvec(np.outer(np.linspace(0, 2 * np.pi, 12, endpoint=False), [1.0, 0, 0]))
    data = carry(rng, Errors(), ACCEL, attitudes=attitudes, gyro_noise=1e-6, latitude=latitude)
    result = calibrate_imu(data.t, data.gyro, data.accel, gravity=GRAVITY, latitude=latitude)
    assert any("Earth rate cannot be used" in note and "bias x" in note for note in result.notes)
    assert "turns between standstills" in result.gyro.method and {"gyro_bias"} <= set(
        result.effect_parameters()
    )
    assert list(result.effect_parameters()["gyro_scale_factor"]) == ["x"]


def test_a_rate_table_gives_the_gyros_scale_and_the_turns_between_rests_their_frame():
    rng = np.random.default_rng(8)
    data = carry(rng, GYRO, ACCEL, poses=14)
    rate, dt = 1.5, 0.01
    blocks = []
    for axis in Rotation.random(16, rng=rng).apply([0, 0, 1.0]):
        true = np.tile(rate * axis, (300, 1))
        blocks.append((GYRO.measure(true) + 0.004 * rng.standard_normal((300, 3)), axis))
    # On the table gravity rotates in the node, so its accelerometer must not look static.
    spin = 5.0 * np.sin(rate * np.arange(300) * dt)[:, None] * np.ones(3)
    gyro = np.vstack([data.gyro, *(b for b, _ in blocks)])
    accel = np.vstack([data.accel, *(ACCEL.measure(spin) for _ in blocks)])
    t = np.arange(len(gyro)) * dt
    result = calibrate_imu(t, gyro, accel, gravity=GRAVITY, table_rate=rate)
    assert "table rate" in result.gyro.method
    assert np.abs(z_scores(result.gyro.triad, np.sqrt(np.diag(result.gyro.covariance)), GYRO)).max() < 4.2
    with pytest.raises(CalibrationError, match="no steady turn"):
        calibrate_imu(data.t, data.gyro, data.accel, gravity=GRAVITY, table_rate=8.0)


def test_detected_standstills_are_those_simulated():
    data = carry(np.random.default_rng(9), GYRO, ACCEL, poses=12, standstill_s=5.0, turn=2.0)
    standstills = find_standstills(data.t, data.gyro, data.accel)
    starts = np.arange(12) * 7.0
    assert len(standstills) == 12
    # The raised cosine starts so gently that the first tenths of a second of a turn are below the noise.
    assert np.abs(standstills.t[:, 0] - starts).max() < 0.5
    assert np.abs(standstills.t[:, 1] - (starts + 5.0)).max() < 0.5


def test_the_error_of_a_mean_is_the_larger_of_single_samples_and_of_blocks():
    """Seed 12: a short white record, and one that drifts from block to block."""
    rng = np.random.default_rng(12)
    white = rng.standard_normal((30, 3))
    assert standard_error(white, 10) == pytest.approx(sem(white))
    slow = np.repeat(rng.standard_normal((8, 3)), 10, axis=0)
    assert standard_error(slow, 10) == pytest.approx(sem(slow[::10]))


def test_the_observability_of_the_frame_is_the_condition_number_of_the_poses():
    """Seed 13: a rotation of the frame changes the angle from Earth rate to up by their cross product."""
    attitudes = Rotation.random(12, random_state=13).as_matrix()
    latitude = 0.8
    up, earth = (attitudes @ each for each in ([0.0, 0.0, 1.0], [np.cos(latitude), 0.0, np.sin(latitude)]))
    result = align_by_earth_rate(GRAVITY * up, 7.292115e-5 * earth, 1e-8, latitude)
    assert result.angle == pytest.approx(np.zeros(3), abs=1e-9)
    assert result.condition == pytest.approx(np.linalg.cond(np.cross(earth, up)))


def test_drifting_and_rotating_standstills_are_left_out_with_a_warning():
    rng = np.random.default_rng(10)
    data = carry(rng, Errors(), Errors(), poses=14)
    accel, gyro = data.accel.copy(), data.gyro.copy()
    standstills = find_standstills(data.t, gyro, accel)
    i, j = standstills.start[3], standstills.end[3]
    accel[i:j, 0] += np.linspace(0, 0.2, j - i)
    i, j = standstills.start[6] - 30, standstills.end[6] + 30
    gyro[i:j] += data.true_force[i:j] / GRAVITY * 0.05
    again = find_standstills(data.t, gyro, accel)
    assert len(again) == 12
    assert any("gravity crept" in text for text in again.rejected)
    assert any("turned at 0.049" in text for text in again.rejected)


def test_gyros_in_degrees_per_second_are_detected_by_the_rotations():
    data = carry(np.random.default_rng(11), Errors(), ACCEL, poses=14, gyro_noise=0.001)
    result = calibrate_imu(data.t, np.degrees(data.gyro), data.accel, gravity=GRAVITY)
    assert any("degrees per second" in note for note in result.notes)
    assert set(result.effect_parameters()) == {
        "accel_bias",
        "accel_scale_factor",
        "accel_nonorthogonality",
        "gyro_bias",
    }


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda t, g, a: (t[:20], g[:20], a[:20]), "shorter than one standstill"),
        (lambda t, g, a: (t, g, a * 0 + 9.8), "never changes"),
        (lambda t, g, a: (t, g, a / 9.80665), "as if it were in g"),
        (lambda t, g, a: (t[:3000], g[:3000], a[:3000]), "do not determine"),
    ],
    ids=["short", "constant", "in g", "four poses"],
)
def test_unusable_records_are_refused_with_a_reason(change, words):
    data = carry(np.random.default_rng(12), Errors(), Errors(), poses=12)
    with pytest.raises(CalibrationError, match=words):
        calibrate_imu(*change(data.t, data.gyro, data.accel), gravity=GRAVITY)


def test_impossible_places_are_refused():
    data = carry(np.random.default_rng(13), Errors(), Errors(), poses=10)
    with pytest.raises(InputError, match="gravity 1 "):
        calibrate_imu(data.t, data.gyro, data.accel, gravity=1)
    with pytest.raises(InputError, match="latitude"):
        calibrate_imu(data.t, data.gyro, data.accel, latitude=2.0)


def test_the_verb_writes_a_file_that_corrects_the_errors_and_keeps_other_entries(tmp_path, capsys):
    data = carry(np.random.default_rng(14), GYRO, ACCEL, poses=12)
    folder = tmp_path / "log"
    folder.mkdir()
    names = ("gx", "gy", "gz", "ax", "ay", "az")
    columns = dict(zip(names, np.column_stack([data.gyro, data.accel]).T, strict=True))
    temperature = np.linspace(20, 25, len(data.t))
    write_table(folder / "hand.csv", Table({"t": data.t, **columns, "temperature": temperature}))
    output = tmp_path / "c.toml"
    output.write_text("[nodes.other.effects.gyro_bias]\nx = { value = 1.0, sigma = 0.1 }\n")
    parser = argparse.ArgumentParser()
    verb.add_arguments(parser)
    line = [str(folder), "--node", "hand", "--gravity", str(GRAVITY), "-o", str(output)]
    result = verb.run(parser.parse_args([*line, "--report", str(tmp_path / "r.html")]))
    read = read_calibration(output)
    assert set(read.nodes) == {"hand", "other"}
    effects = read.nodes["hand"].effects
    assert (
        effects["accel_bias"].temperature == (20.0, 25.0) and len(effects["accel_bias"].source_sha256) == 64
    )
    right = triad_from_effects(effects, "accel").correct(data.accel)
    assert np.abs((right - data.true_force).mean(axis=0)).max() < 0.01
    shown = json.loads(json.dumps(result.as_json(), allow_nan=False))
    assert shown["accel_norm_held_out"]["after_rms"] < 0.01
    assert len(shown["rests"]) == 12
    assert "12 standstills" in (tmp_path / "r.html").read_text()
    alone = verb.run(parser.parse_args([line[0], *line[3:5], "-o", str(tmp_path / "alone.toml")]))
    assert alone.node == "hand" and set(read_calibration(tmp_path / "alone.toml").nodes) == {"hand"}
    with pytest.raises(InputError, match="give --node with one of: hand"):
        verb.run(parser.parse_args([*line[:2], "left", *line[3:]]))


@pytest.mark.parametrize("off_deg", first_and_more(0.3, 0.0), ids=["within 0.3 degrees", "exact"])
def test_six_faces_show_bias_and_scale_and_leave_the_angles_out(off_deg):
    z = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        data = carry(rng, GYRO, ACCEL, attitudes=laid_on_faces(rng, off_deg))
        result = calibrate_imu(data.t, data.gyro, data.accel, gravity=GRAVITY)
        built = result.effect_parameters()
        assert {"accel_bias", "accel_scale_factor", "gyro_bias"} <= set(built)
        assert "accel_nonorthogonality" not in built
        assert any("xz - yz" in note and "midway" in note for note in result.notes)
        for axis, true in zip("xyz", ACCEL.b, strict=True):
            z.append((built["accel_bias"][axis].value - true) / built["accel_bias"][axis].sigma)
            assert built["accel_scale_factor"][axis].sigma < 0.002
    # More than that occurs for one in a thousand of that many values of unit sigma; a smaller rms is
    # cautious.
    assert 0.3 < np.sqrt(np.mean(np.square(z))) < np.sqrt(chi2.isf(1e-3, len(z)) / len(z))


@pytest.mark.parametrize("seeds", first_and_more(range(100, 104), range(104, 112)), ids=str)
def test_gyros_calibrated_by_few_turns_are_as_far_off_as_they_say(seeds):
    z = []
    for seed in seeds:
        data = carry(np.random.default_rng(seed), GYRO, ACCEL, poses=10, standstill_s=3.0, turn=1.5)
        result = calibrate_imu(data.t, data.gyro, data.accel, gravity=GRAVITY)
        # ACCEL is symmetric, so its frame is that of the node.
        z.append(z_scores(result.gyro.triad, np.sqrt(np.diag(result.gyro.covariance)), GYRO)[3:])
    # Correlated values; nine turns leave nine degrees of freedom, so sigmas are those of Student's t.
    assert 0.6 < np.sqrt(np.mean(np.square(z))) < 1.2


def test_angles_of_the_accelerometers_widen_the_gyros_that_were_judged_by_them():
    data = carry(np.random.default_rng(31), GYRO, ACCEL, poses=14, gyro_noise=1e-5)
    result = calibrate_imu(data.t, data.gyro, data.accel, gravity=GRAVITY)
    coarse = replace(result.accel, full_covariance=result.accel.full_covariance * 10**2)
    turns = collect_turns(
        data.t,
        data.gyro,
        result.gyro.triad.bias,
        result.standstills,
        result.accel.triad.correct(result.standstills.accel),
    )
    fine, wide = (
        np.diag(accel_frame_covariance(result.gyro.turns, turns, result.standstills, it))
        for it in (result.accel, coarse)
    )
    assert wide == pytest.approx(fine * 10**2, rel=1e-2)
    # Compare the linear result with refits in which one angle is changed.
    shifted = Triad(
        result.accel.triad.bias,
        result.accel.triad.matrix + 1e-5 * np.array([[0, 1, 0], [1, 0, 0], [0, 0, 0]]),
    )
    turns = estimate_earth_in_turns(turns, np.full(3, 1e-5), None).turns
    base = calibrate_from_turns(turns, np.full(3, 1e-5))
    shifted_turns = collect_turns(
        data.t,
        data.gyro,
        result.gyro.triad.bias,
        result.standstills,
        shifted.correct(result.standstills.accel),
    )
    again = calibrate_from_turns(
        replace(shifted_turns, earth_slopes=turns.earth_slopes, earth_sigma=turns.earth_sigma),
        np.full(3, 1e-5),
    )
    basis = np.zeros(12)
    basis[[4, 6]] = 1e-5
    one = replace(result.accel, full_covariance=np.outer(basis, basis))
    answer = np.sqrt(np.diag(accel_frame_covariance(base, turns, result.standstills, one)))[3:]
    assert answer == pytest.approx(np.abs((again.matrix - base.matrix).ravel()), abs=2e-7)
