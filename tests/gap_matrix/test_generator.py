"""The independent simulator against analytic solutions and a Runge-Kutta integrator, and its files."""

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
WITHOUT_EDGES = slice(10, -10)
SIDES = {"left": 1.0, "right": -1.0}


def build_steady_motion(speed, yaw_rate, seconds=4.0):
    """Return a motion of constant speed and yaw rate."""
    count = round(seconds / world.STEP)
    return Motion(np.full(count, speed), np.full(count, yaw_rate))


@pytest.fixture(scope="module")
def setup():
    return cases.draw_setup(SEED, duration=60.0)


@pytest.fixture(scope="module")
def records_without_effect(setup):
    return {node: cases.simulate_node_record(setup, node, []) for node in SIDES}


@pytest.mark.parametrize(("facing", "sign"), [(1.0, 1.0), (-1.0, -1.0)])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_rolling_forwards_reads_positive_gz_on_a_node_facing_left(side, facing, sign):
    ideal = world.compute_ideal_readings(build_steady_motion(1.5, 0.0), Wheel(side, facing, 0.3, 0.9))
    assert ideal.rate[2][WITHOUT_EDGES] == pytest.approx(sign * 5.0, rel=1e-6)
    assert np.abs(ideal.rate[:2]).max() < 1e-9


def test_gravity_rotates_through_x_and_y_with_the_wheel():
    """At 1.5 m/s with R = 0.3 m, f = g (cos 5t, -sin 5t) facing left; y is opposite facing right."""
    t = np.arange(4000) * world.STEP
    for facing in (1.0, -1.0):
        force = world.compute_ideal_readings(
            build_steady_motion(1.5, 0.0), Wheel(1.0, facing, 0.3, 0.9)
        ).force
        assert force[0][WITHOUT_EDGES] == pytest.approx(GRAVITY * np.cos(5 * t)[WITHOUT_EDGES], abs=1e-6)
        assert force[1][WITHOUT_EDGES] == pytest.approx(
            -facing * GRAVITY * np.sin(5 * t)[WITHOUT_EDGES], abs=1e-6
        )


@pytest.mark.parametrize("angle", [0.0, 2.0, -1.0])
def test_at_standstill_the_specific_force_is_gravity_for_any_camber_grade_and_arm(angle):
    wheel = Wheel(-1.0, -1.0, 0.3, 0.9, angle, camber=0.1, grade=0.07, arm=(0.01, 0.02, 0.03))
    ideal = world.compute_ideal_readings(build_steady_motion(0.0, 0.0), wheel)
    assert np.linalg.norm(ideal.force, axis=0) == pytest.approx(GRAVITY, abs=1e-7)
    assert np.abs(ideal.rate).max() < 1e-9
    at_zero = world.compute_ideal_readings(
        build_steady_motion(0.0, 0.0), replace(wheel, start_angle=0.0, camber=0.0)
    ).force[:, 50]
    assert at_zero == pytest.approx([GRAVITY * np.cos(0.07), -GRAVITY * np.sin(0.07), 0.0], abs=1e-7)


@pytest.mark.parametrize(("side", "sign"), [(1.0, 1.0), (-1.0, -1.0)])
def test_readings_of_a_cambered_wheel_in_a_circle_match_the_analytic_solution(side, sign):
    """The right wheel rolls faster in a steady left circle; the tilted axle measures ± r sin(camber)."""
    speed, turn, radius, track, camber = 1.2, 0.5, 0.3, 0.9, 0.15
    ideal = world.compute_ideal_readings(
        build_steady_motion(speed, turn), Wheel(side, 1.0, radius, track, camber=camber)
    )
    spin = (speed - turn * side * track / 2) / radius
    angle = ideal.angle[WITHOUT_EDGES]
    assert angle == pytest.approx(spin * np.arange(4000)[WITHOUT_EDGES] * world.STEP, abs=1e-9)
    assert ideal.rate[2][WITHOUT_EDGES] == pytest.approx(spin + sign * turn * np.sin(camber), abs=1e-6)
    assert ideal.rate[0][WITHOUT_EDGES] == pytest.approx(turn * np.cos(camber) * np.cos(angle), abs=1e-6)
    assert ideal.rate[1][WITHOUT_EDGES] == pytest.approx(-turn * np.cos(camber) * np.sin(angle), abs=1e-6)
    hub = side * (track / 2 - radius * np.sin(camber))
    inwards = turn * (speed - turn * hub)
    along = inwards * np.cos(camber) + sign * GRAVITY * np.sin(camber)
    assert ideal.force[2][WITHOUT_EDGES] == pytest.approx(along, abs=1e-6)


def test_a_lever_arm_adds_the_centripetal_force_of_a_steady_wheel():
    bare, arm = Wheel(1.0, 1.0, 0.3, 0.9), (0.02, -0.01, 0.05)
    change = (
        world.compute_ideal_readings(build_steady_motion(1.5, 0.0), replace(bare, arm=arm)).force
        - world.compute_ideal_readings(build_steady_motion(1.5, 0.0), bare).force
    )
    for axis, expected in enumerate([-25 * 0.02, 25 * 0.01, 0.0]):
        assert change[axis][WITHOUT_EDGES] == pytest.approx(expected, abs=1e-6)


def test_a_random_drive_agrees_with_the_rigid_body_equation_in_node_axes(setup):
    """The equation is f = C a_h + W' x p + W x (W x p) + g C z, with derivatives by splines.

    C: rotation to node axes, a_h: hub acceleration, W: angular rate, p: lever arm, z: vertical
    """
    motion_of_drive = setup.drive.motion
    seconds = slice(4000, 12_000)
    motion = Motion(motion_of_drive.speed[seconds], motion_of_drive.yaw_rate[seconds])
    v, r, t = motion.speed, motion.yaw_rate, motion.t
    camber, grade, arm = 0.12, 0.05, np.array([0.01, -0.02, 0.03])
    for side, facing in ((1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0)):
        ideal = world.compute_ideal_readings(
            motion, Wheel(side, facing, 0.3, 0.9, 0.4, camber=camber, grade=grade, arm=tuple(arm))
        )
        lean, hub = side * camber, side * (0.45 - 0.3 * np.sin(camber))
        up, forward = np.array([0, -np.sin(lean), np.cos(lean)]), np.array([1.0, 0, 0])
        axle = np.array([0, np.cos(lean), np.sin(lean)])
        c, s = np.cos(ideal.angle)[:, None], np.sin(ideal.angle)[:, None]
        axes = [c * up + s * forward, facing * (c * forward - s * up), np.tile(facing * axle, (len(t), 1))]
        spin = (v - r * side * 0.45) / 0.3
        omega = spin[:, None] * axle + r[:, None] * [0, 0, 1]
        rate = np.stack([np.sum(a * omega, 1) for a in axes], 1)
        rate_derivative = CubicSpline(t, rate)(t, 1)
        hub_acceleration = np.stack(
            [CubicSpline(t, v)(t, 1) - CubicSpline(t, r)(t, 1) * hub, r * (v - r * hub), 0 * v], 1
        )
        specific_force = hub_acceleration + GRAVITY * np.array([np.sin(grade), 0, np.cos(grade)])
        force = np.stack([np.sum(a * specific_force, 1) for a in axes], 1)
        force += np.cross(rate_derivative, arm) + np.cross(rate, np.cross(rate, arm))
        assert ideal.rate.T[WITHOUT_EDGES] == pytest.approx(rate[WITHOUT_EDGES], abs=2e-6)
        # Splines and finite differences smooth a step of the jerk differently.
        assert ideal.force.T[WITHOUT_EDGES] == pytest.approx(force[WITHOUT_EDGES], abs=3e-3)
        assert np.std(ideal.force.T[WITHOUT_EDGES] - force[WITHOUT_EDGES]) < 2e-5


@pytest.mark.parametrize("growth", [0.0, 2e-4])
@pytest.mark.parametrize("eccentricity", [0.0, 0.08])
def test_the_wheel_angle_agrees_with_a_runge_kutta_integrator(growth, eccentricity):
    def speed(t):
        return 2.0 - 1.5 * np.cos(1.3 * t)

    def angle_derivative(t, angle):
        rolling_rate = speed(t) * (1 + 0.02 * 1.95 * np.sin(1.3 * t)) / 0.3
        rolling_rate = float(rolling_rate / (1 + eccentricity * np.cos(angle[0] - 0.7)))
        return [np.roots([growth, 0.0, 1.0, -rolling_rate])[-1].real if growth else rolling_rate]

    t = np.arange(8001) * world.STEP
    reference = solve_ivp(
        angle_derivative, (0.0, 8.0), [0.4], method="DOP853", t_eval=t[::500], rtol=1e-10, atol=1e-10
    )
    wheel = Wheel(
        1.0, 1.0, 0.3, 0.9, 0.4, growth=growth, slip=0.02, eccentricity=eccentricity, phase=0.7
    )  # fmt: skip
    angle = world.wheel_angle(Motion(speed(t), 0 * t), wheel)
    # The tolerance covers the repeated samples at both ends of the derivatives.
    assert angle[::500] == pytest.approx(reference.y[0], abs=2e-6)


def test_drives_start_at_standstill_turn_both_ways_stop_and_have_continuous_accelerations():
    for seed in range(12):
        drive = drives.draw_drive(np.random.default_rng(seed), 120.0)
        v, r = drive.motion.speed, drive.motion.yaw_rate
        assert np.all(v[:2000] == 0.0) and np.all(r[:2000] == 0.0)
        assert v.min() > -0.05 and 1.5 < v.max() < 6.0
        assert r.min() < -0.1 and r.max() > 0.1
        assert np.sum(np.abs(v[5000:-5000]) < 1e-3) > 500
        steps = np.abs(np.diff(v, 2)).max() / world.STEP
        assert steps < 0.1  # m/s² from one sample to the next
        assert 2.9 < np.ptp(drive.temperature) < 12.1


def test_a_bench_is_static_and_warms_up_and_a_turntable_turns():
    rng = np.random.default_rng(3)
    bench, table = drives.draw_drive(rng, 60.0, "bench"), drives.draw_drive(rng, 60.0, "turntable")
    assert not bench.motion.speed.any() and not bench.motion.yaw_rate.any()
    assert bench.temperature[-1] - bench.temperature[0] > 3.0
    assert not table.motion.speed.any() and np.abs(table.motion.yaw_rate).max() > 0.2


def test_an_ideal_sensor_chain_returns_the_ideal_readings_and_each_effect_its_equation(setup):
    ideal = cases.compute_node_readings(setup, "left", [])
    sample_times, temperature = setup.sample_times["left"], setup.drive.temperature
    clean = sensor.compute_clean_readings(ideal, {}, sample_times, temperature)
    step = ideal.motion.step
    for k, row in enumerate([*ideal.rate, *ideal.force]):
        assert clean[:, k] == pytest.approx(np.interp(sample_times, ideal.motion.t, row), abs=2e-3)

    def compute_change(**settings):
        return (sensor.compute_clean_readings(ideal, settings, sample_times, temperature) - clean).T

    d = {"xz": 0.1, "xy": 0.2, "yz": 0.3, "yx": 0.4, "zy": 0.5, "zx": 0.6}
    x, y, z = clean[:, :3].T
    expected = [0.1 * y - 0.2 * z, -0.3 * x + 0.4 * z, 0.5 * x - 0.6 * y]
    assert compute_change(gyro_nonorthogonality=d)[:3] == pytest.approx(np.array(expected), abs=1e-12)
    assert compute_change(gyro_cubic={"z": 1e-4})[2] == pytest.approx(1e-4 * z**3, abs=1e-12)
    assert compute_change(gyro_g_sensitivity={"x": 0.0, "y": 1e-3, "z": 0.0})[2] == pytest.approx(
        1e-3 * clean[:, 4]
    )
    warmup_change = compute_change(gyro_warmup={"x": 0.0, "y": 0.01, "z": 0.0, "time_constant": 20.0})[1]
    assert warmup_change == pytest.approx(0.01 * (1 - np.exp(-sample_times / 20.0)), abs=1e-12)
    temperature_change = compute_change(gyro_temperature={"x": 0.0, "y": 0.0, "z": 1e-3})[2]
    assert temperature_change == pytest.approx(
        1e-3 * (sensor.interpolate_cubic(temperature[None], step, sample_times)[0] - 25.0), abs=1e-12
    )
    misaligned = compute_change(node_misalignment={"x": 1e-3, "y": 0.0, "z": 0.0})
    assert misaligned[1] == pytest.approx(1e-3 * z, abs=2e-5) and misaligned[2] == pytest.approx(
        -1e-3 * y, abs=2e-5
    )


def test_the_low_pass_delays_a_ramp_by_its_time_constant():
    ramp = np.arange(2000)[None] * 1e-3
    delay = ramp - sensor.apply_low_pass(ramp, 0.02, 1e-3)
    assert delay[0, 500:] == pytest.approx(0.02, abs=1e-6)
    assert delay[0, 20] == pytest.approx(0.02 * (1 - np.exp(-1.0)), rel=1e-9)


def test_a_record_is_quantized_and_has_the_declared_noise(setup):
    setup_without_vibration = replace(
        setup, noise={k: replace(n, vibration=0.0) for k, n in setup.noise.items()}
    )
    record = cases.simulate_node_record(setup_without_vibration, "right", [])
    noise = setup_without_vibration.noise["right"]
    steps = record.values / np.repeat([np.radians(0.07), 0.488e-3 * GRAVITY], 3)
    assert steps == pytest.approx(np.round(steps), abs=1e-6)
    assert np.all(np.diff(record.t) > 0.0)
    relative_jitter = np.std(np.diff(record.t)) * noise.rate_hz
    assert relative_jitter == pytest.approx(noise.jitter * np.sqrt(2.0 / 3.0), rel=0.1)
    clean = sensor.compute_clean_readings(
        cases.compute_node_readings(setup_without_vibration, "right", []),
        {},
        setup_without_vibration.sample_times["right"],
        setup_without_vibration.drive.temperature,
    )
    noise_sigma = np.std(record.values - clean, axis=0)
    assert noise_sigma == pytest.approx(np.repeat([noise.gyro, noise.accel], 3), rel=0.05)


@pytest.mark.parametrize("name", effects.KINDS)
def test_an_effect_changes_the_records_of_its_nodes_only(setup, records_without_effect, name):
    effect = cases.draw_hidden_effect(setup, name, None if name in effects.VEHICLE_EFFECTS else "left")
    if name.endswith("saturation"):
        effect = effects.scale_effect(effect, 2.0)
    for node in SIDES:
        before, after = records_without_effect[node], cases.simulate_node_record(setup, node, [effect])
        changed = not (np.array_equal(before.values, after.values) and np.array_equal(before.t, after.t))
        assert changed == effect.applies_to(node)


def test_stale_samples_and_outliers_have_their_expected_number(setup):
    count = len(setup.sample_times["left"])
    repeats = Effect("sample_repeat", "left", {"probability": 0.02})
    values = cases.simulate_node_record(setup, "left", [repeats]).values
    assert np.sum(np.all(values[1:] == values[:-1], axis=1)) == round(0.02 * count)
    outliers = Effect("outliers", "left", {"probability": 0.01, "sigma": 50.0})
    difference = (
        cases.simulate_node_record(setup, "left", [outliers]).values
        - cases.simulate_node_record(setup, "left", []).values
    )
    assert np.sum(difference != 0.0) == pytest.approx(0.01 * difference.size, rel=0.02)


def test_a_written_case_is_complete_and_its_model_file_lacks_the_hidden_effects(tmp_path):
    hidden = make_case.write_case(
        tmp_path, SEED, ["wheel_camber", "gyro_bias"], "faint", duration=60.0, known=["lever_arm"]
    )
    model = tomllib.loads((tmp_path / "model.toml").read_text())
    text = (tmp_path / "model.toml").read_text()
    assert "wheel_camber" not in text and "gyro_bias" not in text and "lever_arm" in text
    assert model["vehicle"].keys() == {"wheel_radius", "track_width"}
    truth = json.loads((tmp_path / "hidden.json").read_text())
    assert [effect["name"] for effect in truth["hidden"]] == [effect.name for effect in hidden]
    assert truth["gain_nats"] == pytest.approx([dose.FAINT_NATS] * 2, rel=0.03)
    for node in model["nodes"]:
        rows = np.loadtxt(tmp_path / f"{node}.csv", delimiter=",", skiprows=1)
        assert np.all(np.diff(rows[:, 0]) > 0.0) and np.isfinite(rows).all()
        steps = rows[:, 1:4] / np.radians(0.07)
        assert steps == pytest.approx(np.round(steps), abs=1e-3)
    reference = np.loadtxt(tmp_path / "reference.csv", delimiter=",", skiprows=1)
    motion = cases.draw_setup(SEED, duration=60.0).drive.motion
    error = reference[:, 1:3] - np.stack([motion.speed, motion.yaw_rate], 1)[::10]
    assert np.std(error, axis=0) == pytest.approx([0.0005, 0.0002], rel=0.05)


def test_drive_and_noise_of_a_seed_do_not_depend_on_hidden_effects(setup):
    same_setup = cases.draw_setup(SEED, duration=60.0)
    effect = cases.draw_hidden_effect(same_setup, "gyro_bias", "left")
    clean, biased = (
        cases.simulate_node_record(setup, "left", []),
        cases.simulate_node_record(same_setup, "left", [effect]),
    )
    assert np.array_equal(clean.t, biased.t) and np.array_equal(clean.values[:, 3:], biased.values[:, 3:])
    assert set(effects.DEVELOPMENT_SEEDS).isdisjoint(effects.TEST_SEEDS)


def test_no_module_that_simulates_data_imports_the_package_under_test():
    folder = Path(__file__).parent
    modules = [path for path in folder.glob("*.py") if not path.name.startswith("test_")]
    modules += [folder / "judge" / "cells.py", folder / "judge" / "logs.py"]
    assert len(modules) >= 12
    for path in modules:
        for node in ast.walk(ast.parse(path.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not [n for n in names if n.split(".")[0] in ("hubodo", "hubowire", "generators")], (
                path.name
            )
