"""Measurement update of a window: clipped channels, gaps, outliers, wheels that are not trusted."""

import cmath
import math

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import norm

from hubodo.earth import STANDARD_GRAVITY
from hubodo.fuse.wheel.config import WheelConfig, WheelNode
from hubodo.fuse.wheel.entries import CAMBER, GYRO_BIAS_X, RATE_BEYOND_RANGE, SPEED, WHEEL_RADIUS, YAW_RATE
from hubodo.fuse.wheel.measurement_update import MeasurementUpdate, UpdateResult
from hubodo.fuse.wheel.measurements import BETWEEN_WHEELS, MEASUREMENTS
from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.mounting_check import inflate_outlier_variances, track_width_test
from hubodo.fuse.wheel.state_vector import InitialState, initial_state
from hubodo.fuse.wheel.wheel import WheelMode
from hubodo.fuse.wheel.window import WINDOW_S, Window

ROWS, ROWS_BETWEEN = len(MEASUREMENTS), len(BETWEEN_WHEELS)
"""Number of rows of one wheel, and of those among them that compare wheels."""

CHANNELS = {"yaw", "roll", "forward", "sideways", "rolling"}
"""Measurements whose channels are listed in this file; an added one has its own `usable`."""

UPRIGHT = cmath.exp(-0.25j)
"""Mean direction of gravity in a wheel that starts upright and turns by half a radian in the window."""

VALID_WINDOW = Window(
    spin=0.5,
    rate_start=5.0,
    rate_end=5.0,
    across=0.01 + 0.02j,
    carrier=0.0997 + 0j,
    force=0.97 * UPRIGHT + 0.01j,
    axial=0.02,
    raw_across=0.01 + 0.02j,
    raw_force=0.95 + 0.04j,
    axial_variance=0.05,
    rate_carrier=0.495,
    lever=-2.5 + 0j,
)


def _make_update(*names: str) -> tuple[MeasurementUpdate, InitialState]:
    """Return an update and an initial state with trusted wheels at the rolling speed of VALID_WINDOW."""
    nodes = {name: WheelNode(name, "left") for name in names}  # type: ignore[arg-type]
    config = WheelConfig(0.15, 0.5, nodes)
    initial = initial_state(config)
    for wheel in initial.wheels:
        wheel.angle_initialised = True
    initial.x[initial.columns.vehicle[SPEED]] = 0.75
    return MeasurementUpdate(config, initial.columns), initial


def _update_windows(update: MeasurementUpdate, initial: InitialState, *windows: Window) -> UpdateResult:
    pairs = tuple(zip(initial.wheels, windows, strict=True))
    return update.update(list(initial.x), initial.p.copy(), pairs, MotionState.MOVING)


@pytest.mark.parametrize(
    ("flags", "expected"),
    [
        ({}, set()),
        ({"across_clipped": 0.1}, {"yaw", "roll"}),
        ({"force_clipped": 0.1}, {"forward", "sideways"}),
        ({"axial_clipped": 0.1}, {"sideways"}),
        ({"spin_clipped": 0.1}, set()),
        ({"spin_clipped": 1.0, "across_clipped": 0.1}, {"yaw", "roll"}),
    ],
)
def test_a_clipped_channel_disables_only_the_measurements_that_use_it(
    flags: dict[str, float], expected: set[str]
) -> None:
    window = VALID_WINDOW._replace(**flags)
    unusable = {
        measurement.__name__.rpartition(".")[2]
        for measurement in MEASUREMENTS
        if not measurement.is_usable(window)
    }  # type: ignore[attr-defined]
    assert unusable & CHANNELS == expected
    update, initial = _make_update("left")
    assert _update_windows(update, initial, window).dof == ROWS - len(unusable)
    # The rows of the other wheel remain.
    update, initial = _make_update("left", "right")
    assert _update_windows(update, initial, window, VALID_WINDOW).dof == 2 * ROWS - len(unusable)


@pytest.mark.parametrize(("missing", "count"), [(0.0, ROWS), (0.499, ROWS), (0.5, 0), (1.0, 0)])
def test_a_window_with_half_of_its_samples_missing_is_not_used(missing: float, count: int) -> None:
    update, initial = _make_update("left")
    assert _update_windows(update, initial, VALID_WINDOW._replace(missing=missing)).dof == count


def test_a_gap_in_a_window_inflates_all_its_variances_by_one_factor() -> None:
    """The factor is 1 + 1e4 times the missing share.

    With exactly known states the innovations contain only measurement noise, and none is an outlier.
    """
    update, initial = _make_update("left")
    initial.p[:] = 0.0
    small_residuals = VALID_WINDOW._replace(across=2e-5 + 3e-5j, force=0.97 * UPRIGHT + 0.002j, axial=0.003)
    complete = _update_windows(update, initial, small_residuals)
    assert 0.01 < complete.nis < 9.0
    with_gap = _update_windows(update, initial, small_residuals._replace(missing=0.3))
    assert complete.nis / with_gap.nis == pytest.approx(1.0 + 1e4 * 0.3)


@pytest.mark.parametrize(
    ("angle_known", "trusted", "count"),
    [
        (True, True, 2 * ROWS),
        (False, True, ROWS + ROWS_BETWEEN),
        (True, False, 2 * ROWS - ROWS_BETWEEN),
        (False, False, ROWS),
    ],
)
def test_rows_used_depend_on_whether_the_angle_is_known_and_the_speed_trusted(
    angle_known: bool, trusted: bool, count: int
) -> None:
    update, initial = _make_update("left", "right")
    initial.wheels[1].angle_initialised = angle_known
    if not trusted:
        initial.wheels[1].best_mode = WheelMode.DISTRUSTED_SPEED
    assert _update_windows(update, initial, VALID_WINDOW, VALID_WINDOW).dof == count


def test_missing_windows_change_nothing() -> None:
    update, initial = _make_update("left", "right")
    missing = Window(missing=1.0)
    result = _update_windows(update, initial, missing, missing)
    assert result.x == initial.x
    assert result.dof == 0
    assert np.array_equal(result.p, initial.p)


def test_a_clipped_channel_disables_rows_of_its_own_wheel_only() -> None:
    """The gyro bias is learnt for the wheel with an unclipped gyro only."""
    update, initial = _make_update("left", "right")
    left, right = (wheel.columns[GYRO_BIAS_X] for wheel in initial.wheels)
    result = _update_windows(update, initial, VALID_WINDOW._replace(across_clipped=1.0), VALID_WINDOW)
    assert result.p[left, left] == pytest.approx(initial.p[left, left], rel=1e-9)
    assert result.p[right, right] < 0.9 * initial.p[right, right]


def test_the_reported_yaw_rate_does_not_depend_on_the_estimated_one() -> None:
    """Compare with the mean rate across the axle, rotated upright and corrected for camber."""
    update, initial = _make_update("left")
    wheel = initial.wheels[0]
    initial.x[wheel.columns[CAMBER]], initial.x[wheel.columns[YAW_RATE]] = 0.4, 0.3
    yaw_rate = _update_windows(update, initial, VALID_WINDOW).yaw_rates[0]
    assert yaw_rate == pytest.approx(
        (wheel.view.rotation * VALID_WINDOW.across).real / WINDOW_S / math.cos(0.4)
    )


def test_an_outlier_counts_as_three_sigma() -> None:
    """The states are known exactly, so rows are independent and the others keep their weight."""
    update, initial = _make_update("left")
    initial.p[:] = 0.0
    without_residuals = VALID_WINDOW._replace(
        across=0j, force=STANDARD_GRAVITY * WINDOW_S * UPRIGHT, axial=0.0
    )
    assert _update_windows(update, initial, without_residuals).nis < 1e-6
    sigma = math.sqrt(
        1.0 / (_update_windows(update, initial, without_residuals._replace(axial=1e-3)).nis / 1e-6)
    )
    for times, nis in ((2.9, 2.9**2), (5.0, 9.0), (500.0, 9.0)):
        assert _update_windows(
            update, initial, without_residuals._replace(axial=times * sigma)
        ).nis == pytest.approx(nis)


def test_a_disagreement_is_attributed_to_the_wheel_farther_from_the_predicted_speed() -> None:
    """Rows 0 and 1 measure yaw, rows 2 and 3 rolling; only the last one is an outlier."""
    whitened, sigma = np.array([0.0, 0.0, 0.5, 6.0]), np.array([1.0, 1.0, 1.0, 0.1])
    compared = ((0, 2), (1, 3))
    for residuals, expected_wheel in (([0.0, 0.0, 0.7, 0.1], 0), ([0.0, 0.0, 0.1, -0.7], 1)):
        inflated, slipping_wheel = inflate_outlier_variances(
            whitened, sigma, np.array(residuals), np.ones(4), compared
        )
        assert slipping_wheel == expected_wheel
        expected = np.ones(4)
        expected[2 + expected_wheel] += 0.7**2
        assert inflated == pytest.approx(expected)


def test_two_yaw_rates_that_disagree_lose_the_same_weight() -> None:
    """Only the second row is an outlier, as it is judged given the first.

    A deviation of 6 sigma with a sigma of 0.1 gets variance until it is 3 sigma.
    """
    whitened, sigma = np.array([0.0, 6.0, 0.0, 0.0]), np.full(4, 0.1)
    inflated, slipping = inflate_outlier_variances(whitened, sigma, np.zeros(4), np.ones(4), ((0, 2), (1, 3)))
    assert slipping is None
    assert inflated == pytest.approx(1.0 + np.array([0.03, 0.03, 0.0, 0.0]))
    without_comparison, _ = inflate_outlier_variances(whitened, sigma, np.zeros(4), np.ones(4), None)
    assert without_comparison == pytest.approx(1.0 + np.array([0.0, 0.03, 0.0, 0.0]))


@pytest.mark.parametrize("prior", [0.02, 0.1])
def test_a_careful_tape_measure_is_accepted_at_a_likelihood_ratio_of_1_28(prior: float) -> None:
    """Compare the densities of both hypotheses at ratios of 1.26 and 1.31.

    The drive determines the track width to 0.1 %; a careful tape measure has 0.5 %, a careless one `prior`.
    """
    drive_variance = 0.001**2
    variance = 1.0 / (1.0 / drive_variance + 1.0 / prior**2)
    careful, careless = norm(scale=math.hypot(0.001, 0.005)), norm(scale=math.hypot(0.001, prior))
    results = []
    for ratio in (1.26, 1.31):
        error = brentq(lambda x, by=ratio: careful.pdf(x) / careless.pdf(x) - by, 0.0, 0.05)
        results.append(track_width_test(error * variance / drive_variance, variance, prior))
    assert results == [math.inf, 0.005**2]


@pytest.mark.parametrize(("turned", "losses"), [(0.0, 0), (0.5, 0), (-0.5, 0), (1.2, 1), (-1.2, 1), (3.1, 1)])
def test_an_angle_is_dropped_if_gravity_turned_over_a_gap_by_more_than_braking_tilts_it(
    turned: float, losses: int
) -> None:
    """The wheel turns half a radian per window; braking with 0.8 g tilts gravity by 0.7 rad."""
    _, initial = _make_update("left")
    wheel = initial.wheels[0]

    def window_with(window: int, extra_angle: float) -> Window:
        angle = 1.0 + 0.5 * window
        return Window(spin=0.5, clock_angle=angle, force=0.98 * cmath.exp(-1j * (angle - 1.0 - extra_angle)))

    for number in range(20):
        wheel.gather_gravity(window_with(number, 0.0))
    wheel.gather_gravity(Window(missing=0.8))
    for number in range(21, 24):
        assert wheel.angle_initialised and wheel.counts.angle_losses == 0
        wheel.gather_gravity(window_with(number, turned))
    assert (wheel.counts.angle_losses, wheel.angle_initialised) == (losses, not losses)


@pytest.mark.parametrize("is_clipped", [False, True])
def test_a_saturated_gyro_leaves_the_radius_and_its_covariance_with_other_states(is_clipped: bool) -> None:
    """Schmidt-Kalman update: the speed is corrected as before and keeps its correlation with the radius."""
    update, initial = _make_update("left")
    columns = initial.wheels[0].columns
    radius, speed = columns[WHEEL_RADIUS], columns[SPEED]
    initial.x[speed] = 0.9
    initial.p[columns[RATE_BEYOND_RANGE], columns[RATE_BEYOND_RANGE]] = 0.25
    result = _update_windows(update, initial, VALID_WINDOW._replace(spin_clipped=float(is_clipped)))
    assert (result.x[radius] == initial.x[radius]) == is_clipped
    assert (result.p[radius, radius] == initial.p[radius, radius]) == is_clipped
    assert result.x[speed] < 0.9 and abs(result.p[radius, speed]) > 0.0
    assert np.linalg.eigvalsh(result.p).min() > -1e-12
