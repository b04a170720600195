"""Application of a calibration: the formula in both directions, order, signs, portions, serials, power-on."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from generators.fake_drive import RADIUS, TRACK, short_drive
from hubodo.calibration.apply import SampleCorrection, apply_calibration, zero_applied_effects
from hubodo.calibration.file import CalibratedEffect, Calibration, NodeCalibration, Quantity
from hubodo.effects import BY_NAME, EFFECTS
from hubodo.effects.field import GyroSupply
from hubodo.errors import CalibrationError
from hubodo.fuse.wheel.config import wheel_config
from hubodo.fuse.wheel.track import run_wheel_filter
from hubodo.recording import Event, Table
from hubodo.vehicle import NodeMount, Vehicle

SIZES = {
    "gyro_bias": 0.05,
    "gyro_warmup": 0.02,
    "gyro_temperature": 0.001,
    "gyro_scale_temperature": 1e-4,
    "accel_temperature": 0.01,
    "accel_scale_temperature": 1e-4,
    "gyro_g_sensitivity": 1e-3,
    "gyro_scale_factor": 0.03,
    "gyro_nonorthogonality": 0.02,
    "gyro_cubic": 2e-5,
    "accel_bias": 0.4,
    "accel_scale_factor": 0.03,
    "accel_nonorthogonality": 0.02,
    "node_misalignment": 0.05,
}


def drawn(seed):
    """Return a calibration with every applied effect, drawn at plausible sizes."""
    rng = np.random.default_rng(seed)
    effects = {}
    for name in SIZES:
        parameters = BY_NAME[name].parameters()
        sizes = {
            p: SIZES[name] * 0.02 ** p.count("_quadratic") * 4e-4 ** p.count("_cubic") for p in parameters
        }
        values = {p: Quantity(float(sizes[p] * rng.normal()), 1e-3) for p in parameters}
        if name == "gyro_warmup":
            values["time_constant"] = Quantity(600.0, 10.0)
            values["time_constant_second"] = Quantity(2500.0, 10.0)
        effects[name] = CalibratedEffect(values)
    return NodeCalibration(effects, "aa01")


def test_every_effect_that_is_undone_is_drawn_here():
    assert set(SIZES) == {kind.name for kind in EFFECTS if kind.is_invertible}


def true_motion(seed, count=50):
    rng = np.random.default_rng(seed)
    gyro = rng.uniform(-25.0, 25.0, (count, 3))
    return (
        gyro,
        rng.uniform(-60.0, 60.0, (count, 3)),
        rng.uniform(0, 4000, count),
        rng.uniform(-10, 60, count),
    )


def chain(node, gyro, accel, age, temperature):
    """Independent sensor chain, sample by sample, in its own order and with scipy's rotations."""

    def v(effect, name):
        return node.effects[effect].parameters[name].value

    def matrix(kind):
        n = {p: v(f"{kind}_nonorthogonality", p) for p in ("xz", "xy", "yz", "yx", "zy", "zx")}
        e = [v(f"{kind}_scale_factor", axis) for axis in "xyz"]
        return np.array(
            [
                [1 + e[0], n["xz"], -n["xy"]],
                [-n["yz"], 1 + e[1], n["yx"]],
                [n["zy"], -n["zx"], 1 + e[2]],
            ]
        )

    def polynomial(kind, axis, warmth):
        names = (axis, f"{axis}_quadratic", f"{axis}_cubic")
        return sum(v(f"{kind}_temperature", name) * warmth ** (n + 1) for n, name in enumerate(names))

    turn = Rotation.from_rotvec([v("node_misalignment", axis) for axis in "xyz"]).inv()
    raw_gyro, raw_accel = [], []
    for w, f, t, warm in zip(gyro, accel, age, temperature, strict=True):
        w, f = turn.apply(w), turn.apply(f)
        warmth = warm - 25.0
        drift = {
            kind: warmth * np.array([v(f"{kind}_scale_temperature", axis) for axis in "xyz"])
            for kind in ("gyro", "accel")
        }
        shown = matrix("gyro") @ w + drift["gyro"] * w
        shown[2] += v("gyro_cubic", "z") * w[2] ** 3
        for i, axis in enumerate("xyz"):
            names = ("x", "y", "z") if axis == "z" else (f"{axis}x", f"{axis}y", f"{axis}z")
            shown[i] += v("gyro_bias", axis)
            for w in ("", "_second"):
                grown = 1 - np.exp(-t / v("gyro_warmup", f"time_constant{w}"))
                shown[i] += v("gyro_warmup", axis + w) * grown
            shown[i] += polynomial("gyro", axis, warmth)
            shown[i] += sum(v("gyro_g_sensitivity", name) * f[k] for k, name in enumerate(names))
        raw_gyro.append(shown)
        bias = [v("accel_bias", axis) + polynomial("accel", axis, warmth) for axis in "xyz"]
        raw_accel.append(matrix("accel") @ f + drift["accel"] * f + bias)
    return np.array(raw_gyro), np.array(raw_accel)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_the_correction_inverts_the_sensor_chain(seed):
    node = drawn(seed)
    correction = SampleCorrection.from_calibration(node)
    gyro, accel, age, temperature = true_motion(seed)
    raw_gyro, raw_accel = chain(node, gyro, accel, age, temperature)
    back = correction.apply(raw_gyro, raw_accel, age=age, temperature=temperature)
    np.testing.assert_allclose(back[0], gyro, rtol=0, atol=1e-11)
    np.testing.assert_allclose(back[1], accel, rtol=0, atol=1e-11)


def test_the_size_of_sample_blocks_does_not_change_the_result():
    correction = SampleCorrection.from_calibration(drawn(3))
    gyro, accel, age, temperature = true_motion(4, 1000)
    whole = correction.apply(gyro, accel, age=age, temperature=temperature)
    for size in (1, 7, 8, 333):
        parts = [slice(k, k + size) for k in range(0, 1000, size)]
        built = [correction.apply(gyro[p], accel[p], age=age[p], temperature=temperature[p]) for p in parts]
        for k in (0, 1):
            np.testing.assert_array_equal(np.concatenate([m[k] for m in built]), whole[k])


def test_a_saturated_channel_is_still_detected_after_calibration():
    node = NodeCalibration({"gyro_bias": CalibratedEffect({"z": Quantity(0.5, 0.01)})})
    raw = np.array([[0.0, 0.0, 35.0], [0.0, 0.0, -35.0], [0.0, 0.0, 30.0]])
    built, _ = SampleCorrection.from_calibration(node).apply(raw, np.zeros((3, 3)))
    np.testing.assert_allclose(built[:, 2], [35.0, -35.5, 29.5])


def test_the_calibration_of_another_node_is_refused_by_both_serials():
    calibration = Calibration({"left": drawn(1)})
    table = Table({name: np.arange(3.0) for name in ("t", "gx", "gy", "gz", "ax", "ay", "az")})
    for key in ("node.left.serial", "serial.left"):
        with pytest.raises(CalibrationError, match=r"aa01.*bb02"):
            apply_calibration({"left": table}, calibration, metadata={key: "bb02"})
        apply_calibration({"left": table}, calibration, metadata={key: "AA01"})


def test_warm_up_counts_from_the_logged_power_on_and_warns_without_one():
    effects = {
        "gyro_warmup": CalibratedEffect({"z": Quantity(1.0, 0.1), "time_constant": Quantity(100.0, 1.0)})
    }
    calibration = Calibration({"left": NodeCalibration(effects)})
    t = 5.0 + np.arange(4.0)
    table = Table({"t": t, **{name: np.zeros(4) for name in ("gx", "gy", "gz", "ax", "ay", "az")}})
    unknown = apply_calibration({"left": table}, calibration)
    np.testing.assert_allclose(unknown.nodes["left"]["gz"], np.expm1(-(t - 5.0) / 100.0), atol=1e-15)
    assert "switched on" in unknown.warnings[0]
    zero = 10**18
    data = [{"power_on_ns": zero - 95 * 10**9}, {"power_on_ns": zero + 6 * 10**9}]
    starts = [Event(zero + 5 * 10**9, "started", "left", "", data[0])]
    starts.append(Event(zero + 7 * 10**9, "started", "left", "", data[1]))
    known = apply_calibration({"left": table}, calibration, events=starts, t_zero_ns=zero)
    expected = np.expm1(-np.array([100.0, 101.0, 1.0, 2.0]) / 100.0)
    np.testing.assert_allclose(known.nodes["left"]["gz"], expected, atol=1e-8)
    assert known.warnings == ()


def test_supply_dependence_is_corrected_if_the_log_has_the_voltage(monkeypatch):
    monkeypatch.setitem(BY_NAME, "gyro_supply", GyroSupply)
    result = CalibratedEffect({"x": Quantity(0.02, 1e-3), "z": Quantity(-0.01, 1e-3)})
    calibration = Calibration({"left": NodeCalibration({"gyro_supply": result})})
    columns = {name: np.full(3, 0.5) for name in ("gx", "gy", "gz", "ax", "ay", "az")}
    unknown = Table({"t": np.arange(3.0), **columns})
    reported = Table({**unknown.columns, "supply": np.array([4.1, np.nan, 3.5])})
    built = apply_calibration({"left": reported}, calibration).nodes["left"]
    # 0.4 V above 3.7 V, 0.1 V interpolated between its neighbours, and 0.2 V below.
    np.testing.assert_allclose(built["gx"], [0.492, 0.498, 0.504], atol=1e-15)
    np.testing.assert_allclose(built["gz"], [0.504, 0.501, 0.498], atol=1e-15)
    np.testing.assert_array_equal(built["gy"], 0.5)
    left = apply_calibration({"left": unknown}, calibration)
    np.testing.assert_array_equal(left.nodes["left"]["gx"], 0.5)
    assert "no supply, so gyro_supply" in left.warnings[0]


@pytest.mark.parametrize(
    ("effect", "values", "words"),
    [
        ("gyro_warmup", {"z": 0.1}, "time_constant"),
        ("gyro_cubic", {"z": 1e-3}, "gyro_cubic"),
        ("accel_scale_factor", {"x": -1.0}, "accel_scale_factor"),
    ],
)
def test_numbers_that_no_sensor_has_are_refused(effect, values, words):
    node = NodeCalibration({effect: CalibratedEffect({name: Quantity(v, 0.1) for name, v in values.items()})})
    with pytest.raises(CalibrationError, match=words):
        SampleCorrection.from_calibration(node)


def test_correcting_samples_or_passing_the_calibration_to_the_filter_gives_the_same_drive():
    """The filter's priors must not apply again what was applied."""
    built = short_drive(11)
    effects = {}
    for name, node in built.nodes.items():
        k = node.truth
        bias = {axis: Quantity(k[f"bias_{axis}"], 1e-3) for axis in "xyz"}
        # All axes are given, because a missing one would be predicted from the others with the calibration
        # alone.
        scale = {axis: Quantity(k["yaw_scale"], 1e-3) for axis in "xy"} | {
            "z": Quantity(k["spin_scale"], 1e-3)
        }
        effects[name] = NodeCalibration(
            {
                "gyro_bias": CalibratedEffect(bias),
                "gyro_scale_factor": CalibratedEffect(scale),
                "lever_arm": CalibratedEffect({"x": Quantity(k["arm_x"], 1e-3)}),
            }
        )
    calibration = Calibration(effects)
    tables = {
        name: Table(dict(zip(("t", "gx", "gy", "gz", "ax", "ay", "az"), np.column_stack(
            [node.t, node.gyro, node.accel]).T, strict=True)))
        for name, node in built.nodes.items()
    }  # fmt: skip
    vehicle = Vehicle(RADIUS, TRACK, {n: NodeMount(n, "left") for n in ("left", "right")})
    applied = apply_calibration(tables, calibration)
    assert applied.summaries["left"]["applied"] == ["gyro_bias", "gyro_scale_factor"]
    corrected = run_wheel_filter(wheel_config(vehicle, list(tables), applied.remaining), applied.nodes).track
    reported = run_wheel_filter(wheel_config(vehicle, list(tables), calibration), tables).track
    twice = run_wheel_filter(wheel_config(vehicle, list(tables), calibration), applied.nodes).track
    same = np.hypot(corrected.x - reported.x, corrected.y - reported.y).max()
    wrong = np.hypot(corrected.x - twice.x, corrected.y - twice.y).max()
    assert same < 0.01 < wrong, f"seed 11: {same} m, {wrong} m"


def test_the_residual_calibration_keeps_sigmas_and_effects_of_the_vehicle():
    node = drawn(5)
    arm = CalibratedEffect({"x": Quantity(0.01, 0.001)})
    node = replace(node, effects={**node.effects, "lever_arm": arm})
    left = zero_applied_effects(Calibration({"left": node})).nodes["left"].effects
    assert left["lever_arm"] == arm
    assert left["gyro_bias"].parameters["x"] == Quantity(0.0, 1e-3)


def test_applying_the_residual_calibration_changes_nothing():
    node = zero_applied_effects(Calibration({"left": drawn(6)})).nodes["left"]
    gyro, accel, age, temperature = true_motion(6)
    built = SampleCorrection.from_calibration(node).apply(gyro, accel, age=age, temperature=temperature)
    np.testing.assert_array_equal(built[0], gyro)
    np.testing.assert_array_equal(built[1], accel)
