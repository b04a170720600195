"""Declarations of effects: signs by facing, odometry priors, variances and inverses."""

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hubodo.calibration.apply import SampleCorrection
from hubodo.calibration.file import CalibratedEffect, NodeCalibration, Quantity
from hubodo.effects import EFFECTS, Noise, distinguishing_manoeuvre
from hubodo.effects.gyro import GyroQuantization, GyroRateRandomWalk
from hubodo.effects.sensor_chain import SensorChain
from hubodo.effects.timing import Outliers
from hubodo.model.forward import NodeInitialState, NodeModel
from hubodo.model.inputs import BodyMotion, MotionInputs, SpeedCorrection, Trace
from hubodo.smoothing_spline import fit_interpolating_spline
from hubodo.vehicle import NodeMount

NEGATED = np.array([[1.0], [-1.0], [-1.0]])
"""What facing right does to the axes of a node, and so to all that is stated in them."""


def reads(effects, facing, side="left", yaw=1.0):
    """Return the mean readings (gyro, accel) of one node, (3, N) each."""
    t = np.arange(0.0, 8.005, 0.01)
    inputs = MotionInputs(
        fit_interpolating_spline(t, 1.5 + np.sin(0.7 * t)),
        fit_interpolating_spline(t, yaw * 0.6 * np.cos(0.9 * t)),
        Trace(np.array([0.0, 8.0]), np.array([20.0, 45.0])),
    )
    node = NodeModel(inputs, t[100:-100], NodeMount(side, facing), 0.31, 0.92)
    reading = node.mean_reading(list(effects), NodeInitialState(0.3))
    return reading.gyro, reading.accel


def sized(kind):
    """Return the effect with distinct parameters, large enough to change every channel."""
    return kind(
        **{name: 3.0 * kind.scale(name) * (1.0 + 0.3 * k) for k, name in enumerate(kind.parameters())}
    )


def facing_right(effect):
    kind = type(effect)
    return kind(
        **{name: kind.facing_sign_of(name, "right") * value for name, value in effect.values().items()}
    )


@pytest.mark.parametrize("kind", EFFECTS, ids=lambda kind: kind.name)
def test_a_node_facing_right_with_flipped_parameters_reads_the_same_with_y_and_z_negated(kind):
    effect = sized(kind)
    left, right = reads([effect], "left"), reads([facing_right(effect)], "right")
    for one, other in zip(left, right, strict=True):
        np.testing.assert_allclose(NEGATED * other, one, rtol=0, atol=1e-9)
    assert all(kind.facing_sign_of(name, "left") == 1.0 for name in kind.parameters())


@pytest.mark.parametrize("kind", EFFECTS, ids=lambda kind: kind.name)
def test_the_opposite_sign_of_a_parameter_changes_the_readings(kind):
    """A parameter with the opposite sign of the declared one changes the readings."""
    plain = facing_right(sized(kind))
    before = np.concatenate(reads([plain], "right"))
    for name, value in plain.values().items():
        if kind.visible_in == "scatter" or name in ("time_constant", "amplitude", "phase"):
            continue
        other = kind(**(plain.values() | {name: -value}))
        assert np.abs(np.concatenate(reads([other], "right")) - before).max() > 1e-4, name


@pytest.mark.parametrize("kind", [k for k in EFFECTS if k.level != "node"], ids=lambda kind: kind.name)
def test_effects_of_wheel_and_vehicle_are_symmetric_in_left_and_right(kind):
    """The mirror image of the vehicle turns in the opposite direction.

    Its left wheel becomes the right one and its node faces the other way; forces mirror as vectors, rates as
    axial vectors.
    """
    effect = [sized(kind)]
    gyro, accel = reads(effect, "left")
    mirrored_gyro, mirrored_accel = reads(effect, "right", side="right", yaw=-1.0)
    np.testing.assert_allclose(mirrored_accel, np.array([[1.0], [-1.0], [1.0]]) * accel, rtol=0, atol=1e-9)
    np.testing.assert_allclose(mirrored_gyro, np.array([[-1.0], [1.0], [-1.0]]) * gyro, rtol=0, atol=1e-9)


def shaken(effects, power_on=-30.0):
    """Return (true gyro, true accel), (read gyro, read accel), age and temperature of a shaken node."""
    t = np.arange(0.0, 8.0, 0.01)
    still = MotionInputs(
        fit_interpolating_spline(t, 0.0 * t), fit_interpolating_spline(t, 0.0 * t), Trace(t, 20.0 + 3.0 * t)
    )

    def carried(at):
        rate = np.stack([3.0 * np.sin(at), 20.0 * np.cos(0.7 * at), 25.0 * np.sin(1.3 * at)])
        slope = np.stack([3.0 * np.cos(at), -14.0 * np.sin(0.7 * at), 32.5 * np.cos(1.3 * at)])
        force = np.stack([5.0 * np.cos(at), 9.8 * np.sin(0.3 * at), 30.0 * np.cos(2.0 * at)])
        return rate, slope, force

    node = NodeModel(still, t, NodeMount(), 0.31, 0.92, power_on, carried)
    read = node.mean_reading(effects, NodeInitialState())
    rate, _, force = carried(t)
    return (rate, force), (read.gyro, read.accel), t - power_on, 20.0 + 3.0 * t


def correction(effects):
    priors = {
        it.name: CalibratedEffect({name: Quantity(value, 0.0) for name, value in it.values().items()})
        for it in effects
    }
    return SampleCorrection.from_calibration(NodeCalibration(priors))


@pytest.mark.parametrize("kind", [k for k in EFFECTS if k.is_invertible], ids=lambda kind: kind.name)
def test_an_invertible_effect_is_removed_exactly(kind):
    true, read, age, warm = shaken([sized(kind)])
    assert max(np.abs(r - w).max() for r, w in zip(read, true, strict=True)) > 1e-3
    back = correction([sized(kind)]).apply(read[0].T, read[1].T, age=age, temperature=warm)
    for result, wanted in zip(back, true, strict=True):
        np.testing.assert_allclose(result.T, wanted, rtol=0, atol=1e-12)


def test_all_invertible_effects_together_are_removed_exactly():
    effects = [sized(kind) for kind in EFFECTS if kind.is_invertible]
    true, read, age, warm = shaken(effects)
    back = correction(effects).apply(read[0].T, read[1].T, age=age, temperature=warm)
    for result, wanted in zip(back, true, strict=True):
        np.testing.assert_allclose(result.T, wanted, rtol=0, atol=1e-11)


@pytest.mark.parametrize("kind", [k for k in EFFECTS if not k.is_invertible], ids=lambda kind: kind.name)
def test_an_effect_that_is_not_invertible_leaves_readings_unchanged(kind):
    """The effect is no error of the sensor, or cannot be inverted: readings stay as they are."""
    result = {name: 3.0 * kind.scale(name) for name in kind.parameters()}
    effect = kind(**{name: min(value, 1.0) if "prob" in name else value for name, value in result.items()})
    _, read, age, warm = shaken([])
    back = correction([effect]).apply(read[0].T, read[1].T, age=age, temperature=warm)
    for result, wanted in zip(back, read, strict=True):
        np.testing.assert_array_equal(result.T, wanted)


def test_a_random_walk_grows_at_its_variance_rate():
    """The variance of an increment over a time is the drift times that time (Brownian motion)."""
    seed, step, ahead = 5, 0.01, 50
    t = np.arange(0.0, 400.0, step)
    walk = GyroRateRandomWalk(3e-3)
    still = MotionInputs(fit_interpolating_spline(t, 0.0 * t), fit_interpolating_spline(t, 0.0 * t))
    result = NodeModel(still, t, NodeMount(), 0.31, 0.92).draw_noise_free(
        [walk], NodeInitialState(), np.random.default_rng(seed)
    )
    gone = result.gyro[:, ahead::ahead] - result.gyro[:, :-ahead:ahead]
    # 2400 increments: their variance is known to 3 %.
    assert np.mean(gone**2) == pytest.approx(walk.random_walk_variance_rate() * ahead * step, rel=0.12), (
        f"seed {seed}"
    )


def test_a_speed_correction_changes_distance_and_acceleration():
    """A speed increased by 0.3 + 0.02 t m/s adds 0.3 t + 0.01 t² m and 0.02 m/s², by hand."""
    t = np.arange(0.0, 10.5, 0.5)
    zero = np.zeros(len(t))
    still = BodyMotion(t, *[zero] * 10)
    result = SpeedCorrection(t, 0.3 + 0.02 * t).apply(still)
    np.testing.assert_allclose(result.speed, 0.3 + 0.02 * t, atol=1e-15)
    np.testing.assert_allclose(result.distance, 0.3 * t + 0.01 * t**2, atol=1e-12)
    np.testing.assert_allclose(result.acceleration, 0.02, atol=1e-12)
    np.testing.assert_array_equal(result.yaw_rate, zero)


def test_the_tables_of_the_readme_are_those_of_the_classes():
    tool = Path(__file__).parents[3] / "tools" / "gen_tables.py"
    run = subprocess.run([sys.executable, tool, "--check"], capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, run.stderr


def test_odometry_priors_are_positive_and_processes_are_stationary():
    priors = {
        (kind.name, name): kind.odometry_prior(name)
        for kind in EFFECTS
        for name in kind.parameters()
        if kind.odometry_prior(name) is not None
    }
    assert {f"{effect}.{name}" for effect, name in priors} == {
        *(f"gyro_scale_factor.{axis}" for axis in "xyz"),
        *(f"gyro_bias.{axis}" for axis in "xyz"),
        *(f"accel_bias.{axis}" for axis in "xyz"),
        *("gyro_g_sensitivity.xx", "gyro_g_sensitivity.yy"),
        *("accel_nonorthogonality.zx", "accel_nonorthogonality.zy"),
        *("node_misalignment.x", "node_misalignment.y", "lever_arm.x", "lever_arm.y"),
        *("wheel_camber.angle", "wheel_radius.error", "track_width.error", "road_grade.angle"),
        "time_offset.delay",
    }
    for place, one in priors.items():
        assert one.sigma > 0.0 and one.random_walk >= 0.0 and one.origin, place
        if math.isfinite(one.correlation_time):
            # Gauss-Markov process: the variance lost per second equals that added by the random walk.
            assert one.random_walk**2 == pytest.approx(2.0 / one.correlation_time * one.sigma**2), place


def test_three_of_nine_g_sensitivities_are_fitted_to_a_drive():
    kind = next(kind for kind in EFFECTS if kind.name == "gyro_g_sensitivity")
    bench = kind(xy=2e-3, yz=1e-3)
    assert kind.fitted_parameters() == ("x", "y", "z") and len(bench.coordinates()) == 3
    changed = bench.with_coordinates(np.array([1e-4, 2e-4, 3e-4]))
    assert (changed.x, changed.y, changed.z, changed.xy, changed.yz) == (1e-4, 2e-4, 3e-4, 2e-3, 1e-3)
    plain_gyro, plain_force = reads([], "left")
    added = reads([bench], "left")[0] - plain_gyro
    np.testing.assert_allclose(added[0], 2e-3 * plain_force[1], rtol=0, atol=1e-12)
    np.testing.assert_allclose(added[1], 1e-3 * plain_force[2], rtol=0, atol=1e-12)
    np.testing.assert_allclose(added[2], 0.0, rtol=0, atol=1e-15)


def test_the_distinguishing_manoeuvre_does_not_depend_on_the_order_of_the_effects():
    words = "drive long and fast: gravity in ax and ay counts the turns of the wheel"
    assert distinguishing_manoeuvre("gyro_scale_factor", "wheel_radius") == words
    assert distinguishing_manoeuvre("wheel_radius", "gyro_scale_factor") == words
    assert (
        distinguishing_manoeuvre("wheel_radius", "outliers")
        == distinguishing_manoeuvre("empirical:gz ~ spin", "wheel_radius")
        == ""
    )


def test_the_added_variance_is_that_of_simulated_readings():
    """Rounding adds a constant variance; outliers add a multiple of the noise variance."""
    rng, count = np.random.default_rng(8), 400_000
    noise, step = Noise(0.004, 0.05), 0.02
    rate = rng.uniform(-3.0, 3.0, (3, count))
    chain = SensorChain(np.arange(count) * 0.01, np.full(count, 25.0), *np.zeros((5, 3, count)))
    chain.gyro = rate.copy()
    rounded = GyroQuantization(step=step)
    rounded.quantize_readings(chain)
    assert rounded.added_variance(noise) == (pytest.approx(np.var(chain.gyro - rate), rel=0.01), 0.0)
    chain.gyro = np.zeros((3, count))
    wild = Outliers(probability=0.05, sigma=10.0)
    wild.add_outliers(chain, noise, rng)
    priors = np.var(chain.gyro), np.var(chain.accel)
    assert wild.added_variance(noise) == pytest.approx(priors, rel=0.05)
