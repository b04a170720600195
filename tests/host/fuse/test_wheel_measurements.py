"""Measurement models of the wheel filter: derivatives against differences, residuals on a rigid wheel."""

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest

from generators import wheel_drives
from hubodo.fuse.wheel import measurements
from hubodo.fuse.wheel.config import WheelConfig, WheelNode, WheelNoise
from hubodo.fuse.wheel.entries import (
    ACCEL_BIAS_Z,
    CAMBER,
    GYRO_SCALE_ACROSS,
    LEVER_ARM_X,
    LEVER_ARM_Y,
    SPEED,
    WHEEL_ANGLE,
    WHEEL_ENTRIES,
    YAW_RATE,
    Entry,
    StateLayout,
)
from hubodo.fuse.wheel.filter import WheelFilter
from hubodo.fuse.wheel.integrals import cosine_and_sine
from hubodo.fuse.wheel.measurements import (
    MEASUREMENTS,
    LinearisedWindow,
    WheelGeometry,
    WindowNoise,
    centripetal,
    gravity_phase,
    position,
    steady,
    zero_velocity,
)
from hubodo.fuse.wheel.measurements.shared import Row
from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.preintegration import WindowBuilder
from hubodo.fuse.wheel.window import WINDOW_S, Window
from wheel_runs import sample_columns

AT = StateLayout(1, position_aided=True).wheels[0]
POSITION = position.Position(3.0, -2.0, 0.5)
NODE_FIXED_TERMS = steady.NodeFixedTerms(3.0 - 50.0j, 0.4 + 1.3j, 0.2, 0.01, -62.0, -3900.0 + 7.0j, 0.31)


def _view(geometry: WheelGeometry, window: Window, x: list[float]) -> LinearisedWindow:
    view = LinearisedWindow(geometry, AT)
    view.linearise(x, window, is_stationary=False)
    view.yaw_change = 0.7
    return view


def _centripetal(view: LinearisedWindow) -> tuple[Row]:
    row = centripetal.measure(view, WheelNoise())
    assert row is not None
    return (row,)


# Name -> (STATES, entries left out on purpose, function that returns the rows of one window).
CASES: dict[
    str, tuple[tuple[Entry, ...], tuple[Entry, ...], Callable[[LinearisedWindow], tuple[Row, ...]]]
] = {
    "centripetal": (centripetal.STATES, centripetal.UNCORRECTED_STATES, _centripetal),
    "position": (position.STATES, (), lambda view: position.measure(view.x, AT, POSITION)),
    "gravity_phase": (
        gravity_phase.STATES,
        gravity_phase.UNCORRECTED_STATES,
        lambda view: (gravity_phase.measure(view, 0.7),),
    ),
    "steady": (steady.STATES, (), lambda view: steady.measure(view.x, AT, NODE_FIXED_TERMS, WheelNoise())),
    "zero velocity": (
        zero_velocity.STATES,
        (),
        lambda view: zero_velocity.measure(view.x, AT, MotionState.STANDSTILL),
    ),
}
NOISE = WindowNoise(WheelNoise(), 0.31)
for measurement_module in MEASUREMENTS:
    name = measurement_module.__name__.rpartition(".")[2]  # type: ignore[attr-defined]
    CASES[name] = (
        measurement_module.STATES,
        (),
        lambda view, measurement_module=measurement_module: (measurement_module.measure(view, NOISE),),
    )  # type: ignore[misc]


def _window(rng: np.random.Generator, spin_rate: float, facing: str) -> Window:
    """Return a window of random samples of a node with that spin rate, rad/s, in node axes."""
    t = np.arange(31) * 0.01
    gyro = 0.3 * rng.standard_normal((31, 3))
    gyro[:, 2] += spin_rate
    accel = 4.0 * rng.standard_normal((31, 3))
    return WindowBuilder(facing, 0.0).add_many(t, gyro, accel)[1]  # type: ignore[arg-type]


@pytest.mark.parametrize("facing", ["left", "right"])
@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("measurement", CASES)
def test_derivatives_of_every_measurement_equal_central_differences(
    measurement: str, seed: int, side: float, facing: str
) -> None:
    """Differentiate by each parameter in node axes; a state that is not in STATES must not matter."""
    print("seed", seed)
    states, left_out, measure = CASES[measurement]
    rng = np.random.default_rng(seed)
    window = _window(rng, float(rng.uniform(-34.0, 34.0)), facing)
    geometry = WheelGeometry(side, 0.31, 0.46 * side, 1.0)
    entries = sorted(AT, key=lambda entry: AT[entry])
    sign = np.array([entry.sign(facing) for entry in entries])  # type: ignore[arg-type]
    point = 0.1 * rng.standard_normal(len(entries))

    def rows(parameters: np.ndarray) -> tuple[Row, ...]:
        return measure(_view(geometry, window, (sign * parameters).tolist()))

    def residuals(parameters: np.ndarray) -> np.ndarray:
        return np.array([row[0] for row in rows(parameters)])

    analytic_rows = rows(point)
    assert tuple(entry for row in analytic_rows for entry in row[2]) == states, "not in the order of STATES"
    assert all(row[1] > 0.0 for row in analytic_rows)
    step = 1e-6
    for k, entry in enumerate(entries):
        if entry in left_out:
            continue
        shift = step * (np.arange(len(entries)) == k)
        numeric = (residuals(point - shift) - residuals(point + shift)) / (2.0 * step)
        analytic = [sign[k] * row[2].get(entry, 0.0) for row in analytic_rows]
        # Truncation: step² times third derivatives, up to 1e3 in the term w² ρ; rounding: 1e-16 of some tens,
        # divided by the step.
        assert analytic == pytest.approx(numeric, rel=1e-7, abs=1e-8), str(entry)


def test_a_measurement_added_to_the_tuple_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """The added measurement sets the axial accelerometer bias far from its value on the drive. Seed 3."""
    rng = np.random.default_rng(3)
    drive = wheel_drives.drive(wheel_drives.loop(rng, 15.0, 5.0), rng)

    def measure(w: LinearisedWindow, noise: WindowNoise) -> Row:
        return 7.0 - w.x[w.columns[ACCEL_BIAS_Z]], 1e-12, {ACCEL_BIAS_Z: 1.0}

    axial_bias = SimpleNamespace(STATES=(ACCEL_BIAS_Z,), is_usable=lambda window: True, measure=measure)

    def biases() -> list[float]:
        nodes = {name: WheelNode(name, "left") for name in drive.nodes}  # type: ignore[arg-type]
        wheel_filter = WheelFilter(WheelConfig(drive.radius, drive.track, nodes))
        wheel_filter.handle_blocks(sample_columns(drive))
        return [wheel_filter.core.estimate(name, ACCEL_BIAS_Z).value for name in drive.nodes]

    assert max(abs(value) for value in biases()) < 2.0
    monkeypatch.setattr(measurements, "PER_WHEEL", (*measurements.PER_WHEEL, axial_bias))
    # Outliers are limited to three sigma per window, so the state takes several windows to arrive.
    assert biases() == pytest.approx([7.0, 7.0], abs=0.01)


def _largest_residuals(drive: wheel_drives.WheelDrive, side: str, camber: float) -> dict[str, float]:
    """Return the largest residual of each measurement with the states at their true values."""
    node = drive.nodes[side]
    sign = 1.0 if side == "left" else -1.0
    geometry = WheelGeometry(sign, drive.radius, 0.5 * sign * drive.track)
    view, noise = LinearisedWindow(geometry, AT), WindowNoise(WheelNoise(), drive.radius)
    x = [0.0] * len(AT)
    x[AT[WHEEL_ANGLE]], x[AT[CAMBER]] = node.truth["start_angle"], camber
    x[AT[LEVER_ARM_X]], x[AT[LEVER_ARM_Y]] = node.truth["arm_x"], node.truth["arm_y"]
    largest = dict.fromkeys(MEASUREMENTS, 0.0)
    for window in WindowBuilder("left", 0.0).add_many(node.t, node.gyro, node.accel):
        samples = slice(window.number * 100, window.number * 100 + 101)
        x[AT[YAW_RATE]] = (drive.heading[samples][-1] - drive.heading[samples][0]) / WINDOW_S
        x[AT[SPEED]] = float(np.mean(drive.speed[samples]))
        view.linearise(x, window, is_stationary=False)
        for measurement in MEASUREMENTS:
            largest[measurement] = max(largest[measurement], abs(measurement.measure(view, noise)[0]))
        x[AT[WHEEL_ANGLE]] += view.rolling_rate * WINDOW_S
    return {measurement.__name__.rpartition(".")[2]: value for measurement, value in largest.items()}  # type: ignore[attr-defined]


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("camber", [0.0, 0.3])
def test_all_residuals_vanish_at_the_true_state_of_a_rigid_wheel(side: str, camber: float) -> None:
    """The generator differentiates the drive numerically in world axes and shares no equation with the
    model.
    """
    seed = 11
    rng = np.random.default_rng(seed)
    plan = wheel_drives.legs([(2.0, 0.0, 0.0), (6.0, 1.5, 0.3), (6.0, 2.0, -0.4)])
    arm = (0.03, -0.02)
    drive = wheel_drives.drive(plan, rng, wheel_drives.PERFECT, camber=camber, rate_hz=1000.0, arm=arm)
    largest = _largest_residuals(drive, side, camber)
    # Half a step of the chip (0.07 deg/s; 0.488 mg) over a window, plus the curvature of speed within one.
    gyro, accel = wheel_drives.GYRO_STEP * WINDOW_S, wheel_drives.ACCEL_STEP * WINDOW_S
    assert largest["yaw"] < gyro, f"seed {seed}"
    # The wheel angle is integrated from quantised spin for 14 s: its milliradians turn yaw into roll.
    assert largest["roll"] < 3 * gyro
    # A lever arm of 36 mm at w² = 170 (rad/s)² senses 6 m/s²; a thousandth of that remains.
    assert largest["forward"] < 20 * accel
    assert largest["sideways"] < 20 * accel
    assert largest["rolling"] < 2e-4


def test_parameters_estimated_as_one_state_share_sign_and_prior() -> None:
    """Parameters that the filter only observes together must be declared equally in their effect."""
    for entry in WHEEL_ENTRIES:
        for parameter in entry.parameters:
            assert entry.effect_class is not None
            assert entry.effect_class.odometry_prior(parameter) == entry.effect_class.odometry_prior(
                entry.parameters[0]
            ), entry
            assert entry.effect_class.facing_sign_of(parameter, "right") == entry.effect_class.facing_sign_of(
                entry.parameters[0], "right"
            ), entry
    assert GYRO_SCALE_ACROSS.parameters == ("x", "y")


def test_axial_and_gyro_variances_are_about_the_window_mean() -> None:
    """White noise on means far from zero; the mean of 40 samples takes one degree of freedom."""
    rng = np.random.default_rng(31)
    count, sigma = 80_000, 0.3
    accel = np.column_stack([np.zeros((count, 2)), 4.0 + sigma * rng.standard_normal(count)])
    gyro = np.array([0.5, -0.2, 3.0]) + 0.02 * rng.standard_normal((count, 3))
    windows = WindowBuilder("left", 0.0).add_many(np.arange(count) / 400.0, gyro, accel)
    share = 1.0 - 1.0 / (400.0 * WINDOW_S)
    assert np.mean([window.axial_variance for window in windows]) == pytest.approx(share * sigma**2, rel=0.02)
    assert np.mean([window.gyro_variance for window in windows]) == pytest.approx(
        share * 3 * 0.02**2, rel=0.02
    )


def test_sine_and_cosine_do_not_depend_on_the_array_size() -> None:
    angle = np.linspace(-400.0, 400.0, 1001)
    all_at_once = cosine_and_sine(angle)
    assert np.allclose(all_at_once, (np.cos(angle), np.sin(angle)), rtol=0.0, atol=1e-15)
    for first, last in ((0, 1), (1, 8), (8, 1001)):
        part = cosine_and_sine(angle[first:last])
        assert np.array_equal(part, np.array(all_at_once)[:, first:last])
