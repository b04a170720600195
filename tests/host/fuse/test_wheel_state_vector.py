"""State vector of the wheel filter: priors, single rows and positions against textbook Kalman equations."""

import numpy as np
import pytest

from hubodo.calibration.file import Quantity
from hubodo.fuse.wheel.config import WheelConfig, WheelNode
from hubodo.fuse.wheel.entries import (
    ANTENNA_X,
    GYRO_BIAS_Z,
    GYRO_SCALE_ACROSS,
    GYRO_SCALE_Z,
    HEADING,
    SLOPE,
    SPEED,
    TIME_OFFSET,
    TRACK_WIDTH,
    WHEEL_ANGLE,
    YAW_RATE,
    YAW_RATE_FROM_GRAVITY,
    Entry,
    X,
    Y,
)
from hubodo.fuse.wheel.measurements.position import Position
from hubodo.fuse.wheel.records import History
from hubodo.fuse.wheel.state_vector import StateVector, initial_state
from hubodo.fuse.wheel.thresholds import GATE_SIGMA


def _state(*names: str, seed: int | None = None, **settings: object) -> StateVector:
    """Return the initial state; seed: of states and of a full covariance in its place."""
    nodes = {name: WheelNode(name, "left") for name in names or ("left", "right")}  # type: ignore[arg-type]
    state = StateVector(initial_state(WheelConfig(0.15, 0.5, nodes, **settings)), History(5))  # type: ignore[arg-type]
    if seed is not None:
        print("seed", seed)
        rng = np.random.default_rng(seed)
        root = rng.standard_normal((len(state.x), len(state.x))) / len(state.x) ** 0.5
        state.x, state.p = rng.standard_normal(len(state.x)).tolist(), root @ root.T
    return state


def _kalman(
    x: np.ndarray, p: np.ndarray, h: np.ndarray, z: np.ndarray, r: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the update in information form, (n,) and (n, n): P⁻¹ + Hᵀ R⁻¹ H."""
    inverse = np.linalg.inv(r)
    after = np.linalg.inv(np.linalg.inv(p) + h.T @ inverse @ h)
    return x + after @ h.T @ inverse @ z, after


@pytest.mark.parametrize("seed", range(3))
def test_a_single_row_is_the_kalman_update(seed: int) -> None:
    state = _state(seed=seed)
    x, p = np.array(state.x), state.p.copy()
    columns = state.wheels[1].columns
    h = np.zeros((1, len(x)))
    h[0, columns[SPEED]], h[0, columns[GYRO_BIAS_Z]] = 2.0, -0.7
    expected = _kalman(x, p, h, np.array([0.3]), np.array([[0.5]]))
    state.update_with_row((0.3, 0.5, {SPEED: 2.0, GYRO_BIAS_Z: -0.7}), columns)
    assert np.array(state.x) == pytest.approx(expected[0], abs=1e-9)
    assert state.p == pytest.approx(expected[1], abs=1e-9)


def test_an_outlier_has_the_innovation_variance_of_a_residual_at_the_gate() -> None:
    state = _state(seed=1)
    x, p, column = np.array(state.x), state.p.copy(), state.columns.vehicle[SPEED]
    residual = 100.0
    state.update_with_row((residual, 0.5, {SPEED: 1.0}), state.columns.vehicle)
    s = (residual / GATE_SIGMA) ** 2
    assert np.array(state.x) - x == pytest.approx(p[:, column] * residual / s)
    assert state.p == pytest.approx(p - np.outer(p[:, column], p[:, column]) / s)


@pytest.mark.parametrize("seed", range(3))
def test_a_position_is_the_kalman_update_with_numerical_derivatives(seed: int) -> None:
    state = _state(seed=seed, position_aided=True)
    x, p, measured = np.array(state.x), state.p.copy(), Position(3.0, -2.0, 0.5)
    innovation = state.position_innovation(measured)

    def residual(states: np.ndarray) -> np.ndarray:
        state.x = states.tolist()
        return state.position_innovation(measured).z

    step = 1e-6
    h = -np.column_stack(
        [(residual(x + step * unit) - residual(x - step * unit)) / (2 * step) for unit in np.eye(len(x))]
    )
    state.x = x.tolist()
    r = 0.25 * np.eye(2)
    assert innovation.s == pytest.approx(h @ p @ h.T + r, abs=1e-6)
    assert innovation.nis == pytest.approx(
        innovation.z @ np.linalg.inv(h @ p @ h.T + r) @ innovation.z, rel=1e-5
    )
    assert innovation.cost == pytest.approx(innovation.nis + np.log(np.linalg.det(innovation.s)))
    expected = _kalman(x, p, h, innovation.z, r)
    state.update_with_position(innovation)
    assert np.array(state.x) == pytest.approx(expected[0], abs=1e-5)
    assert state.p == pytest.approx(expected[1], abs=1e-5)


def test_inflation_adds_variance_to_its_entries_alone() -> None:
    state = _state(seed=4)
    x, p, vehicle = list(state.x), state.p.copy(), state.columns.vehicle
    state.inflate({X: 2.0, HEADING: 0.5})
    p[vehicle[X], vehicle[X]] += 2.0
    p[vehicle[HEADING], vehicle[HEADING]] += 0.5
    assert state.x == x
    assert np.array_equal(state.p, p)


def test_the_state_starts_at_standstill_at_the_origin_with_the_priors_of_the_entries() -> None:
    state = _state()
    assert set(state.x) == {0.0}
    for entry in (SPEED, YAW_RATE, TRACK_WIDTH, TIME_OFFSET, SLOPE, X, Y):
        assert state.estimate(None, entry) == Quantity(0.0, pytest.approx(entry.prior)), entry
    for name in ("left", "right"):
        assert state.estimate(name, WHEEL_ANGLE).sigma == pytest.approx(WHEEL_ANGLE.prior)
    for wheel in state.wheels:
        z, across = wheel.columns[GYRO_SCALE_Z], wheel.columns[GYRO_SCALE_ACROSS]
        assert state.p[z, across] > 0.0
        state.p[z, across] = state.p[across, z] = 0.0
    assert np.array_equal(state.p, np.diag(np.diag(state.p)))


def test_the_rotation_of_the_ground_at_an_unknown_place_is_common_to_both_wheels() -> None:
    known, unknown = _state(), _state(ground_rate_sigma=4e-5)
    columns = [wheel.columns[YAW_RATE_FROM_GRAVITY] for wheel in known.wheels]
    added = unknown.p - known.p
    assert added[np.ix_(columns, columns)] == pytest.approx(np.full((2, 2), 1.6e-9))
    assert np.count_nonzero(added) == 4


def test_priors_of_a_calibration_and_the_start_heading_replace_those_of_the_entries() -> None:
    nodes = {"left": WheelNode("left", "left", priors={GYRO_BIAS_Z: Quantity(0.02, 0.001)})}
    config = WheelConfig(
        0.15, 0.5, nodes, priors={TRACK_WIDTH: Quantity(0.01, 0.002)}, start_heading=1.2, heading_sigma=0.1
    )
    state = StateVector(initial_state(config), History(5))
    assert state.estimate("left", GYRO_BIAS_Z) == Quantity(0.02, 0.001)
    assert state.estimate(None, TRACK_WIDTH) == Quantity(0.01, 0.002)
    assert state.estimate(None, HEADING) == Quantity(1.2, pytest.approx(0.1))


def test_one_wheel_has_no_delay_against_another_and_only_an_aided_filter_an_antenna() -> None:
    assert _state("left").estimate(None, TIME_OFFSET) == Quantity(0.0, 0.0)
    assert ANTENNA_X not in _state().columns.vehicle
    assert _state(position_aided=True).estimate(None, ANTENNA_X).sigma == pytest.approx(ANTENNA_X.prior)


def test_a_steered_wheel_has_its_contact_at_the_body_origin() -> None:
    nodes = {"left": WheelNode("left", "left"), "right": WheelNode("right", "left", steered=True)}
    wheels = initial_state(WheelConfig(0.15, 0.5, nodes)).wheels
    assert [wheel.geometry.contact_y for wheel in wheels] == [0.25, 0.0]
    assert [wheel.geometry.side for wheel in wheels] == [1.0, -1.0]


def test_the_scale_about_the_axle_predicts_the_scale_across_it() -> None:
    """Each gyro has 1 % of common and 0.7 % of own scale error; x and y count as their mean."""
    rng = np.random.default_rng(5)
    axes = 0.01 * rng.standard_normal((200_000, 1)) + 0.007 * rng.standard_normal((200_000, 3))
    expected = np.cov(axes[:, 2], axes[:, :2].mean(axis=1))
    state = _state()
    for wheel in state.wheels:
        columns = [wheel.columns[entry] for entry in (GYRO_SCALE_Z, GYRO_SCALE_ACROSS)]
        assert state.p[np.ix_(columns, columns)] == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("known", [(GYRO_SCALE_Z,), (GYRO_SCALE_ACROSS,), (GYRO_SCALE_Z, GYRO_SCALE_ACROSS)])
def test_a_calibrated_gyro_scale_is_the_prior(known: tuple[Entry, ...]) -> None:
    """A calibrated scale keeps its value and sigma; it predicts the one across the axle that is not."""
    calibrated = Quantity(-0.006, 0.0005)
    node = WheelNode("left", "left", dict.fromkeys(known, calibrated))
    state = StateVector(initial_state(WheelConfig(0.15, 0.5, {"left": node})), History(5))
    for entry in known:
        assert state.estimate("left", entry).value == calibrated.value
        assert state.estimate("left", entry).sigma == pytest.approx(calibrated.sigma)
    across = state.estimate("left", GYRO_SCALE_ACROSS)
    if GYRO_SCALE_ACROSS not in known:
        # E[(x + y) / 2 | z] and its variance, of the sizes in the test above.
        gain = 1e-4 / (1e-4 + 0.49e-4)
        assert across.value == pytest.approx(gain * calibrated.value)
        assert across.sigma**2 == pytest.approx(1e-4 + 0.245e-4 - gain * 1e-4 + (gain * 0.0005) ** 2)
    assert np.linalg.eigvalsh(state.p).min() >= 0.0
