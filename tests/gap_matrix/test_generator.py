"""The second generator against hand-solved wheels, a textbook integrator and what its files promise."""

import ast
import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from gap_matrix import cases, dose, drives, effects, make_case, sensor, world
from gap_matrix.effects import Effect
from gap_matrix.world import GRAVITY, Motion, Wheel

SEED = 7
INSIDE = slice(10, -10)
SIDES = {"left": 1.0, "right": -1.0}


def steady(speed, yaw_rate, seconds=4.0):
    count = round(seconds / world.STEP)
    return Motion(np.full(count, speed), np.full(count, yaw_rate))


@pytest.fixture(scope="module")
def minute():
    return cases.setup(SEED, duration=60.0)


@pytest.mark.parametrize(("facing", "sign"), [(1.0, 1.0), (-1.0, -1.0)])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_rolling_forwards_reads_positive_gz_on_a_node_that_faces_left(side, facing, sign):
    felt = world.feel(steady(1.5, 0.0), Wheel(side, facing, 0.3, 0.9))
    assert felt.rate[2][INSIDE] == pytest.approx(sign * 5.0, rel=1e-6)
    assert np.abs(felt.rate[:2]).max() < 1e-9


def test_gravity_turns_through_x_and_y_as_often_as_the_wheel():
    """Rolling at 1.5 m/s with R = 0.3 m: f = g (cos 5t, -sin 5t) facing left; the other y facing right."""
    t = np.arange(4000) * world.STEP
    for facing in (1.0, -1.0):
        force = world.feel(steady(1.5, 0.0), Wheel(1.0, facing, 0.3, 0.9)).force
        assert force[0][INSIDE] == pytest.approx(GRAVITY * np.cos(5 * t)[INSIDE], abs=1e-6)
        assert force[1][INSIDE] == pytest.approx(-facing * GRAVITY * np.sin(5 * t)[INSIDE], abs=1e-6)


@pytest.mark.parametrize("angle", [0.0, 2.0, -1.0])
def test_at_rest_the_force_is_gravity_whatever_camber_grade_and_arm(angle):
    wheel = Wheel(-1.0, -1.0, 0.3, 0.9, angle, camber=0.1, grade=0.07, arm=(0.01, 0.02, 0.03))
    felt = world.feel(steady(0.0, 0.0), wheel)
    assert np.linalg.norm(felt.force, axis=0) == pytest.approx(GRAVITY, abs=1e-7)
    assert np.abs(felt.rate).max() < 1e-9
    at_zero = world.feel(steady(0.0, 0.0), replace(wheel, start_angle=0.0, camber=0.0)).force[:, 50]
    assert at_zero == pytest.approx([GRAVITY * np.cos(0.07), -GRAVITY * np.sin(0.07), 0.0], abs=1e-7)


@pytest.mark.parametrize(("side", "sign"), [(1.0, 1.0), (-1.0, -1.0)])
def test_a_cambered_wheel_in_a_circle_reads_what_its_tilted_axle_says(side, sign):
    """Steady left circle: the outer (right) wheel rolls faster; the leaning axle sees ± r sin(camber)."""
    speed, turn, radius, track, camber = 1.2, 0.5, 0.3, 0.9, 0.15
    felt = world.feel(steady(speed, turn), Wheel(side, 1.0, radius, track, camber=camber))
    spin = (speed - turn * side * track / 2) / radius
    angle = felt.angle[INSIDE]
    assert angle == pytest.approx(spin * np.arange(4000)[INSIDE] * world.STEP, abs=1e-9)
    assert felt.rate[2][INSIDE] == pytest.approx(spin + sign * turn * np.sin(camber), abs=1e-6)
    assert felt.rate[0][INSIDE] == pytest.approx(turn * np.cos(camber) * np.cos(angle), abs=1e-6)
    assert felt.rate[1][INSIDE] == pytest.approx(-turn * np.cos(camber) * np.sin(angle), abs=1e-6)
    hub = side * (track / 2 - radius * np.sin(camber))
    inwards = turn * (speed - turn * hub)
    along = inwards * np.cos(camber) + sign * GRAVITY * np.sin(camber)
    assert felt.force[2][INSIDE] == pytest.approx(along, abs=1e-6)


def test_a_lever_arm_adds_the_centripetal_force_of_a_steady_wheel():
    bare, arm = Wheel(1.0, 1.0, 0.3, 0.9), (0.02, -0.01, 0.05)
    added = (
        world.feel(steady(1.5, 0.0), replace(bare, arm=arm)).force - world.feel(steady(1.5, 0.0), bare).force
    )
    for axis, expected in enumerate([-25 * 0.02, 25 * 0.01, 0.0]):
        assert added[axis][INSIDE] == pytest.approx(expected, abs=1e-6)


def test_any_drive_agrees_with_the_rigid_body_equation_in_node_axes(minute):
    """f = C a_h + W' x p + W x (W x p) + g C z with everything present, derivatives by splines elsewhere."""
    whole = minute.drive.motion
    motion = Motion(whole.speed[:20_000], whole.yaw_rate[:20_000])
    v, r, t = motion.speed, motion.yaw_rate, motion.t
    camber, grade, arm = 0.12, 0.05, np.array([0.01, -0.02, 0.03])
    for side, facing in ((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0)):
        felt = world.feel(
            motion, Wheel(side, facing, 0.3, 0.9, 0.4, camber=camber, grade=grade, arm=tuple(arm))
        )
        lean, hub = side * camber, side * (0.45 - 0.3 * np.sin(camber))
        up, forward = np.array([0, -np.sin(lean), np.cos(lean)]), np.array([1.0, 0, 0])
        axle = np.array([0, np.cos(lean), np.sin(lean)])
        c, s = np.cos(felt.angle)[:, None], np.sin(felt.angle)[:, None]
        axes = [c * up + s * forward, facing * (c * forward - s * up), np.tile(facing * axle, (len(t), 1))]
        spin = (v - r * side * 0.45) / 0.3
        omega = spin[:, None] * axle + r[:, None] * [0, 0, 1]
        rate = np.stack([np.sum(a * omega, 1) for a in axes], 1)
        d_rate = CubicSpline(t, rate)(t, 1)
        hub_acc = np.stack(
            [CubicSpline(t, v)(t, 1) - CubicSpline(t, r)(t, 1) * hub, r * (v - r * hub), 0 * v], 1
        )
        pull = hub_acc + GRAVITY * np.array([np.sin(grade), 0, np.cos(grade)])
        force = np.stack([np.sum(a * pull, 1) for a in axes], 1)
        force += np.cross(d_rate, arm) + np.cross(rate, np.cross(rate, arm))
        assert felt.rate.T[INSIDE] == pytest.approx(rate[INSIDE], abs=2e-6)
        # Where the drive's jerk steps, spline and difference round the corner differently.
        assert felt.force.T[INSIDE] == pytest.approx(force[INSIDE], abs=3e-3)
        assert np.std(felt.force.T[INSIDE] - force[INSIDE]) < 2e-5


@pytest.mark.parametrize("growth", [0.0, 2e-4])
@pytest.mark.parametrize("eccentricity", [0.0, 0.08])
def test_the_wheel_angle_solves_its_equation_as_a_runge_kutta_integrator_does(growth, eccentricity):
    def speed(t):
        return 2.0 - 1.5 * np.cos(1.3 * t)

    def turning(t, angle):
        wanted = speed(t) * (1 + 0.02 * 1.95 * np.sin(1.3 * t)) / 0.3
        wanted = float(wanted / (1 + eccentricity * np.cos(angle[0] - 0.7)))
        return [np.roots([growth, 0.0, 1.0, -wanted])[-1].real if growth else wanted]

    t = np.arange(8001) * world.STEP
    theirs = solve_ivp(turning, (0.0, 8.0), [0.4], method="DOP853", t_eval=t[::500], rtol=1e-10, atol=1e-10)
    wheel = Wheel(
        1.0, 1.0, 0.3, 0.9, 0.4, growth=growth, slip=0.02, eccentricity=eccentricity, phase=0.7
    )  # fmt: skip
    ours = world.wheel_angle(Motion(speed(t), 0 * t), wheel)
    # The first and last steps of the acceleration repeat their neighbours.
    assert ours[::500] == pytest.approx(theirs.y[0], abs=2e-6)


def test_drives_start_at_rest_turn_both_ways_stop_and_have_continuous_accelerations():
    for seed in range(12):
        drive = drives.draw(np.random.default_rng(seed), 120.0)
        v, r = drive.motion.speed, drive.motion.yaw_rate
        assert np.all(v[:2000] == 0.0) and np.all(r[:2000] == 0.0)
        assert v.min() > -0.05 and 1.5 < v.max() < 6.0
        assert r.min() < -0.1 and r.max() > 0.1
        assert np.sum(np.abs(v[5000:-5000]) < 1e-3) > 500
        steps = np.abs(np.diff(v, 2)).max() / world.STEP
        assert steps < 0.1  # m/s² from one sample to the next
        assert 2.9 < np.ptp(drive.temperature) < 12.1


def test_a_bench_rests_and_warms_up_and_a_turntable_turns():
    rng = np.random.default_rng(3)
    bench, table = drives.draw(rng, 60.0, "bench"), drives.draw(rng, 60.0, "turntable")
    assert not bench.motion.speed.any() and not bench.motion.yaw_rate.any()
    assert bench.temperature[-1] - bench.temperature[0] > 3.0
    assert not table.motion.speed.any() and np.abs(table.motion.yaw_rate).max() > 0.2


def test_a_perfect_chain_gives_the_channels_and_each_part_enters_where_it_should(minute):
    felt = cases.channels(minute, "left", [])
    taken, warmth = minute.taken["left"], minute.drive.temperature
    plain = sensor.clean(felt, {}, taken, warmth)
    step = felt.motion.step
    for k, row in enumerate([*felt.rate, *felt.force]):
        assert plain[:, k] == pytest.approx(np.interp(taken, felt.motion.t, row), abs=2e-3)

    def change(**settings):
        return (sensor.clean(felt, settings, taken, warmth) - plain).T

    d = {"xz": 0.1, "xy": 0.2, "yz": 0.3, "yx": 0.4, "zy": 0.5, "zx": 0.6}
    x, y, z = plain[:, :3].T
    expected = [0.1 * y - 0.2 * z, -0.3 * x + 0.4 * z, 0.5 * x - 0.6 * y]
    assert change(gyro_nonorthogonality=d)[:3] == pytest.approx(np.array(expected), abs=1e-12)
    assert change(gyro_cubic={"z": 1e-4})[2] == pytest.approx(1e-4 * z**3, abs=1e-12)
    assert change(gyro_g_sensitivity={"x": 0.0, "y": 1e-3, "z": 0.0})[2] == pytest.approx(1e-3 * plain[:, 4])
    warm = change(gyro_warmup={"x": 0.0, "y": 0.01, "z": 0.0, "time_constant": 20.0})[1]
    assert warm == pytest.approx(0.01 * (1 - np.exp(-taken / 20.0)), abs=1e-12)
    cold = change(gyro_temperature={"x": 0.0, "y": 0.0, "z": 1e-3})[2]
    assert cold == pytest.approx(1e-3 * (sensor.sampled(warmth[None], step, taken)[0] - 25.0), abs=1e-12)
    turned = change(node_misalignment={"x": 1e-3, "y": 0.0, "z": 0.0})
    assert turned[1] == pytest.approx(1e-3 * z, abs=2e-5) and turned[2] == pytest.approx(-1e-3 * y, abs=2e-5)


def test_the_low_pass_is_late_by_its_time_constant_on_a_ramp():
    ramp = np.arange(2000)[None] * 1e-3
    late = ramp - sensor.one_pole(ramp, 0.02, 1e-3)
    assert late[0, 500:] == pytest.approx(0.02, abs=1e-6)
    assert late[0, 20] == pytest.approx(0.02 * (1 - np.exp(-1.0)), rel=1e-9)


def test_a_record_lies_on_the_chips_steps_and_its_noise_is_as_said(minute):
    quiet = replace(minute, noise={k: replace(n, vibration=0.0) for k, n in minute.noise.items()})
    record = cases.record(quiet, "right", [])
    noise = quiet.noise["right"]
    steps = record.values / np.repeat([np.radians(0.07), 0.488e-3 * GRAVITY], 3)
    assert steps == pytest.approx(np.round(steps), abs=1e-6)
    assert np.all(np.diff(record.t) > 0.0)
    spread = np.std(np.diff(record.t)) * noise.rate_hz
    assert spread == pytest.approx(noise.jitter * np.sqrt(2.0 / 3.0), rel=0.1)
    clean = sensor.clean(
        cases.channels(quiet, "right", []), {}, quiet.taken["right"], quiet.drive.temperature
    )
    own = np.std(record.values - clean, axis=0)
    assert own == pytest.approx(np.repeat([noise.gyro, noise.accel], 3), rel=0.05)


@pytest.mark.parametrize("name", effects.KINDS)
def test_every_effect_changes_its_own_nodes_record_and_no_others(minute, name):
    effect = cases.hidden_effect(minute, name, None if name in effects.VEHICLE else "left")
    if name.endswith("saturation"):
        effect = effects.scaled(effect, 2.0)
    for node in SIDES:
        before, after = cases.record(minute, node, []), cases.record(minute, node, [effect])
        changed = not (np.array_equal(before.values, after.values) and np.array_equal(before.t, after.t))
        assert changed == effect.concerns(node)


def test_counted_effects_have_the_number_their_probability_says(minute):
    count = len(minute.taken["left"])
    stale = Effect("sample_repeat", "left", {"probability": 0.02})
    values = cases.record(minute, "left", [stale]).values
    assert np.sum(np.all(values[1:] == values[:-1], axis=1)) == round(0.02 * count)
    jumps = Effect("outliers", "left", {"probability": 0.01, "sigma": 50.0})
    difference = cases.record(minute, "left", [jumps]).values - cases.record(minute, "left", []).values
    assert np.sum(difference != 0.0) == pytest.approx(0.01 * difference.size, rel=0.02)


def test_a_written_case_is_complete_and_its_model_file_hides_what_is_hidden(tmp_path):
    hidden = make_case.write_case(
        tmp_path, SEED, ["wheel_camber", "gyro_bias"], "faint", duration=60.0, known=["lever_arm"]
    )
    model = tomllib.loads((tmp_path / "model.toml").read_text())
    text = (tmp_path / "model.toml").read_text()
    assert "wheel_camber" not in text and "gyro_bias" not in text and "lever_arm" in text
    assert model["vehicle"].keys() == {"wheel_radius", "track_width"}
    truth = json.loads((tmp_path / "hidden.json").read_text())
    assert [found["name"] for found in truth["hidden"]] == [effect.name for effect in hidden]
    assert truth["gain_nats"] == pytest.approx([dose.FAINT] * 2, rel=0.03)
    for node in model["nodes"]:
        rows = np.loadtxt(tmp_path / f"{node}.csv", delimiter=",", skiprows=1)
        assert np.all(np.diff(rows[:, 0]) > 0.0) and np.isfinite(rows).all()
        steps = rows[:, 1:4] / np.radians(0.07)
        assert steps == pytest.approx(np.round(steps), abs=1e-3)
    reference = np.loadtxt(tmp_path / "reference.csv", delimiter=",", skiprows=1)
    motion = cases.setup(SEED, duration=60.0).drive.motion
    error = reference[:, 1:3] - np.stack([motion.speed, motion.yaw_rate], 1)[::10]
    assert np.std(error, axis=0) == pytest.approx([0.0005, 0.0002], rel=0.05)


def test_the_same_seed_is_the_same_drive_and_noise_whatever_is_hidden(minute):
    again = cases.setup(SEED, duration=60.0)
    effect = cases.hidden_effect(again, "gyro_bias", "left")
    plain, biased = cases.record(minute, "left", []), cases.record(again, "left", [effect])
    assert np.array_equal(plain.t, biased.t) and np.array_equal(plain.values[:, 3:], biased.values[:, 3:])
    assert set(effects.DEVELOPMENT_SEEDS).isdisjoint(effects.TEST_SEEDS)


def test_nothing_in_this_room_that_makes_data_imports_the_package_under_test():
    room = Path(__file__).parent
    makers = [path for path in room.glob("*.py") if not path.name.startswith("test_")]
    makers += [room / "judge" / "cells.py", room / "judge" / "logs.py"]
    assert len(makers) >= 12
    for path in makers:
        for node in ast.walk(ast.parse(path.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not [n for n in names if n.split(".")[0] in ("hubodo", "hubowire", "generators")], (
                path.name
            )
