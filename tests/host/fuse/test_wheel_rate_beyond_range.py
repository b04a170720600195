"""The spin rate beyond the range of a clipped gyro: found from gravity, estimated as a state, discarded."""

from __future__ import annotations

import cmath
import math
from typing import Any

import numpy as np
import pytest

from hubodo.earth import STANDARD_GRAVITY
from hubodo.fuse.wheel.config import WheelConfig, WheelNode
from hubodo.fuse.wheel.entries import HEADING, LEVER_ARM_X, LEVER_ARM_Y, RATE_BEYOND_RANGE, WHEEL_ANGLE, X, Y
from hubodo.fuse.wheel.preintegration import WindowBuilder
from hubodo.fuse.wheel.rate_beyond_range import derotate_window, reset_misaligned_angle
from hubodo.fuse.wheel.spin_search import SpinTracker, _Samples, find_spin, rederotate_window
from hubodo.fuse.wheel.state_vector import initial_state
from hubodo.fuse.wheel.window import WINDOW_S, Window

G, R, LIMIT = STANDARD_GRAVITY, 0.3, 34.0
ARM, BIAS = 0.02 - 0.01j, 0.3 + 0.2j


def rolling_windows(
    spin: float,
    slope: float = 0.0,
    *,
    gravity: float = G,
    rate_hz: float = 104.0,
    seconds: float = 1.0,
    arm: complex = 0j,
    bias: complex = 0j,
    accel_limit: float = np.inf,
) -> list[Window]:
    """Return windows of a wheel with spin rate spin + slope t, rad/s, and an angle of 0.4 at 0 s.

    The gyro saturates at LIMIT. The hub accelerates with R times the change of the rate; the force is gravity
    and this acceleration in wheel axes, plus the bias and the lever-arm terms in node axes.
    """
    t = np.arange(-0.02, seconds + 0.05, 1.0 / rate_hz)
    rate = spin + slope * t
    angle = 0.4 + spin * t + 0.5 * slope * t * t
    force = (gravity + 1j * R * slope) * np.exp(-1j * angle) + bias + arm * (1j * slope - rate**2)
    gyro, accel = np.zeros((2, len(t), 3))
    gyro[:, 2] = np.clip(rate, -LIMIT, LIMIT)
    accel[:, 0], accel[:, 1] = force.real, force.imag
    return WindowBuilder("left", 0.0, LIMIT, accel_limit).add_many(t, gyro, accel)


@pytest.mark.parametrize("slope", [0.0, 30.0, -30.0])
def test_rederotating_with_excess_and_slope_equals_an_unclipped_gyro(slope: float) -> None:
    rng = np.random.default_rng(3)
    t = np.arange(-0.05, 0.6, 1.0 / 208.0)
    gyro, accel = rng.standard_normal((2, len(t), 3))
    gyro[:, 2] += 20.0
    full_gyro = gyro.copy()
    # The excess is 7 rad/s in the middle of the window from 0.3 to 0.4 s.
    full_gyro[:, 2] += 7.0 + slope * (t - 0.35)
    clipped, unclipped = (WindowBuilder("left", 0.0, 0.1).add_many(t, w, accel)[3] for w in (gyro, full_gyro))
    rederotated = rederotate_window(clipped, 7.0, slope)
    for name in ("carrier", "force", "across", "rate_carrier", "lever"):
        # Linear interpolation between samples differs from a parabola by slope dt² / 8 at most.
        assert abs(getattr(rederotated, name) - getattr(unclipped, name)) < 3e-4 * max(
            1.0, abs(getattr(unclipped, name))
        )
    for name in ("rate_start", "rate_end"):
        assert getattr(rederotated, name) - getattr(clipped, name) == pytest.approx(
            getattr(unclipped, name) - getattr(clipped, name) - 7.0
        )
    assert rederotated.spin == clipped.spin
    without_samples = clipped._replace(samples=None)
    assert rederotate_window(without_samples, 7.0) is without_samples


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("spin", "slope"), [(34.6, 0.0), (50.13, 7.7), (90.4, 20.9), (90.4, -20.9), (130.0, 32.0), (230.0, 0.0)]
)
def test_the_search_finds_spin_rate_and_angle_at_both_ends(spin: float, slope: float, sign: float) -> None:
    windows = rolling_windows(sign * spin, sign * slope, rate_hz=208.0)[2:9]
    estimate = find_spin(windows, R)
    assert estimate is not None
    start, end = 0.2, 0.9
    for t, angle in ((start, estimate.start_angle), (end, estimate.end_angle)):
        truth = 0.4 + sign * (spin * t + 0.5 * slope * t * t)
        assert cmath.phase(cmath.exp(1j * (angle - truth))) == pytest.approx(0.0, abs=0.012)
    for middle, excess in ((start + 0.05, estimate.excess), (end - 0.05, estimate.excess_end)):
        assert excess == pytest.approx(sign * (spin + slope * middle - LIMIT), abs=0.04)


@pytest.mark.parametrize(("factor", "accepted"), [(0.57, False), (0.63, True), (1.47, True), (1.53, False)])
def test_a_rotating_force_is_accepted_from_0_6_to_1_5_times_gravity(factor: float, accepted: bool) -> None:
    windows = rolling_windows(60.0, gravity=factor * G)[:8]
    assert (find_spin(windows, R) is not None) == accepted
    tracker = SpinTracker(R)
    tracker.initialise(60.0 - LIMIT, 0.0)
    for window in windows:
        tracker.track_window(window, 0j, 0j)
    assert tracker.is_observed == accepted


def test_the_search_needs_a_quarter_of_a_second_of_valid_samples() -> None:
    """At 104 Hz; samples of windows with a clipped force or a gap do not count."""
    windows = rolling_windows(60.0, rate_hz=104.0)
    assert find_spin(windows[:2], R) is None
    assert find_spin(windows[:3], R) is not None
    gaps = [window._replace(missing=0.1) for window in windows[2:]]
    assert find_spin([*windows[:2], *gaps], R) is None
    assert find_spin(rolling_windows(60.0, accel_limit=0.6 * G)[:8], R) is None
    assert find_spin([window._replace(samples=None) for window in windows], R) is None
    # One window with enough samples is sufficient.
    estimate = find_spin(rolling_windows(80.0, rate_hz=416.0)[4:5], R)
    assert estimate is not None and estimate.excess == pytest.approx(80.0 - LIMIT, abs=1.0)


@pytest.mark.parametrize("spin", [35.0, 60.0])
def test_the_chirp_amplitude_equals_the_least_squares_fit_with_bias_and_lever_arm(spin: float) -> None:
    """The rotation may be so small that a polynomial of time absorbs a part of it."""
    samples = _Samples.of(rolling_windows(spin, rate_hz=208.0, bias=BIAS, arm=ARM)[3:5])
    assert samples is not None
    chirp = samples.without(3).best(np.array([spin - LIMIT]), np.zeros(1))
    columns = np.column_stack(
        [np.exp(-1j * (samples.carried + (spin - LIMIT) * samples.t)), samples.t[:, None] ** np.arange(3)]
    )
    fitted = np.linalg.lstsq(columns, samples.force, rcond=None)[0][0]
    assert abs(fitted) == pytest.approx(G)
    assert chirp.amplitude == pytest.approx(fitted)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("slope", "initial_error"),
    [(0.0, 6.0), (0.0, -6.0), (20.3, 0.0), (-20.3, 0.0), (31.0, 0.0), (-31.0, 0.0)],
)
def test_the_tracker_follows_gravity_corrected_for_lever_arm_and_bias(
    slope: float, initial_error: float, sign: float
) -> None:
    """It starts with a slope of zero and an excess that is wrong by as much as braking causes."""
    spin = 80.0
    windows = rolling_windows(sign * spin, sign * slope, arm=ARM, bias=BIAS, rate_hz=208.0)
    tracker = SpinTracker(R)
    tracker.initialise(sign * (spin - LIMIT) + initial_error, 0.0)
    assert not tracker.is_tracking
    for window in windows[:8]:
        tracker.track_window(window, ARM, BIAS)
        assert tracker.is_tracking
    middle = 0.75
    assert tracker.is_observed
    assert tracker.excess == pytest.approx(sign * (spin + slope * middle - LIMIT), abs=0.1)
    assert tracker.slope == pytest.approx(sign * slope, abs=0.6)
    tracker.pause()
    assert not tracker.is_tracking and not tracker.is_observed


def test_an_uncorrected_lever_arm_biases_the_tracker_while_braking() -> None:
    windows = rolling_windows(80.0, -20.0, arm=3.0 * ARM, rate_hz=208.0)
    errors = []
    for arm in (3.0 * ARM, -3.0 * ARM):
        tracker = SpinTracker(R)
        tracker.initialise(80.0 - LIMIT, -20.0)
        for window in windows[:8]:
            tracker.track_window(window, arm, 0j)
        errors.append(abs(tracker.excess - (80.0 - 20.0 * 0.75 - LIMIT)))
    assert errors[0] < 0.05 < errors[1]


def test_without_rotating_force_the_rate_is_extrapolated_with_a_decaying_slope() -> None:
    """The slope is halved in each window from the fourth on."""
    windows = rolling_windows(60.0, gravity=0.0)
    tracker = SpinTracker(R)
    tracker.initialise(20.0, 8.0)
    excess, slope = 20.0, 8.0
    for number, window in enumerate(windows[:6], start=1):
        tracker.track_window(window, 0j, 0j)
        excess += slope * WINDOW_S
        slope *= 0.5 if number >= 4 else 1.0
        assert (tracker.excess, tracker.slope, tracker.is_observed) == (
            pytest.approx(excess),
            slope,
            False,
        )
    tracker.pause()
    assert not tracker.is_tracking and tracker.excess == pytest.approx(excess)
    tracker.track_window(windows[6], 0j, 0j)
    tracker.record_unclipped(Window(rate_start=3.0, rate_end=4.5))
    assert not tracker.is_tracking and not tracker.is_observed
    assert (tracker.excess, tracker.slope) == (0.0, pytest.approx(15.0))


MAX_RATE_CHANGE = 3.0 * WINDOW_S / R
"""Largest change of the spin rate from window to window, rad/s."""


class FakeSpinTracker:
    """A spin tracker with given outputs that records the calls."""

    def __init__(
        self, observed: bool, tracking: bool = True, excess: float = 12.0, slope: float = -4.0
    ) -> None:
        self.is_observed, self.is_tracking, self.excess, self.slope = observed, tracking, excess, slope
        self.calls: list[str] = []
        self.last_arguments: tuple[Any, ...] = ()

    def track_window(self, *args: Any) -> None:
        self.calls.append("track_window")
        self.last_arguments = args

    def record_unclipped(self, window: Window) -> None:
        self.calls.append("record_unclipped")

    def pause(self) -> None:
        self.calls.append("pause")


def make_wheel(tracker: FakeSpinTracker | None = None):  # type: ignore[no-untyped-def]
    """Return a wheel of known angle, its states and their covariance."""
    initial = initial_state(WheelConfig(R, 0.6, {"left": WheelNode("left", "left")}))
    (wheel,) = initial.wheels
    wheel.angle_initialised = True
    if tracker is not None:
        wheel.spin_tracker = tracker  # type: ignore[assignment]
    p = initial.p + 0.01 * np.ones_like(initial.p)
    p[wheel.columns[RATE_BEYOND_RANGE], :] = p[:, wheel.columns[RATE_BEYOND_RANGE]] = 0.0
    return wheel, list(initial.x), p


IN_RANGE = Window(spin=2.0, force=0.9 + 0.1j)
CLIPPED = IN_RANGE._replace(spin_clipped=1.0)


def test_a_window_in_gyro_range_is_not_changed() -> None:
    wheel, x, p = make_wheel(FakeSpinTracker(False))
    before = p.copy()
    assert derotate_window(x, p, wheel, IN_RANGE) == (IN_RANGE, [])
    assert wheel.spin_tracker.calls == ["record_unclipped"] and wheel.angle_initialised
    assert np.array_equal(p, before)


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_a_partly_clipped_window_resets_the_excess_with_a_small_sigma(share: float) -> None:
    wheel, x, p = make_wheel(FakeSpinTracker(False))
    column = wheel.columns[RATE_BEYOND_RANGE]
    x[column], p[column, :], p[:, column] = 9.0, 0.2, 0.2
    window = rolling_windows(60.0)[3]._replace(spin_clipped=share)
    derotated, reset_states = derotate_window(x, p, wheel, window)
    assert reset_states == [column] and x[column] == 0.0
    assert p[column, column] == pytest.approx((MAX_RATE_CHANGE * share) ** 2)
    assert np.count_nonzero(p[column]) == np.count_nonzero(p[:, column]) == (share > 0.0)
    assert derotated == rederotate_window(window, 0.0)


@pytest.mark.parametrize(("tracking", "angle_valid"), [(True, False), (False, True)])
def test_a_missing_window_while_tracking_drops_the_angle(tracking: bool, angle_valid: bool) -> None:
    wheel, x, p = make_wheel(FakeSpinTracker(False, tracking))
    derotate_window(x, p, wheel, Window(missing=1.0))
    assert wheel.angle_initialised == angle_valid and wheel.spin_tracker.calls == ["pause"]


def test_an_observed_excess_rate_reinitialises_its_state() -> None:
    wheel, x, p = make_wheel(FakeSpinTracker(True))
    column = wheel.columns[RATE_BEYOND_RANGE]
    p[column, :], p[:, column] = 0.01, 0.01
    x[wheel.columns[LEVER_ARM_X]], x[wheel.columns[LEVER_ARM_Y]] = 0.02, -0.03
    window = rolling_windows(60.0)[3]
    derotated, reset_states = derotate_window(x, p, wheel, window)
    assert reset_states == [column] and x[column] == 12.0
    assert p[column, column] == pytest.approx((0.15 / R) ** 2)
    assert np.count_nonzero(p[column]) == 1
    assert derotated == rederotate_window(window, 12.0, -4.0)
    assert wheel.spin_tracker.last_arguments == (window, 0.02 - 0.03j, 0j)


def test_an_unobserved_excess_rate_is_extrapolated_or_set_to_that_of_the_search() -> None:
    for variance, expected in ((0.0, 12.0), (0.5, 7.0 - 0.4)):
        wheel, x, p = make_wheel(FakeSpinTracker(False))
        column = wheel.columns[RATE_BEYOND_RANGE]
        x[column], p[column, column] = 7.0, variance
        _, reset_states = derotate_window(x, p, wheel, CLIPPED)
        assert reset_states == [] and x[column] == pytest.approx(expected)
        assert p[column, column] == pytest.approx(variance + MAX_RATE_CHANGE**2)


@pytest.mark.parametrize(("variance", "losses"), [(0.98, 0), (1.02, 1)])
@pytest.mark.parametrize("cross", [0.2, -0.2])
def test_an_angle_sigma_of_one_radian_at_mid_window_drops_the_angle(
    variance: float, losses: int, cross: float
) -> None:
    """Angle at the start and half a window of the excess rate, with their correlation."""
    wheel, x, p = make_wheel(FakeSpinTracker(False))
    angle, excess = wheel.columns[WHEEL_ANGLE], wheel.columns[RATE_BEYOND_RANGE]
    p[excess, excess], p[angle, excess], p[excess, angle] = 4.0, cross, cross
    p[angle, angle] = variance - WINDOW_S * cross - 0.25 * WINDOW_S**2 * (4.0 + MAX_RATE_CHANGE**2)
    derotate_window(x, p, wheel, CLIPPED)
    assert (wheel.angle_losses, wheel.angle_initialised) == (losses, not losses)


@pytest.mark.parametrize(
    ("slipping", "force_clipped", "observed", "tracking", "losses"),
    [
        (False, True, False, False, 0),
        (True, False, False, True, 0),
        (True, False, True, False, 1),
        (True, True, False, True, 1),
        (True, True, True, True, 0),
    ],
)
def test_a_slipping_wheel_loses_its_angle_where_the_spin_is_not_tracked(
    slipping: bool, force_clipped: bool, observed: bool, tracking: bool, losses: int
) -> None:
    wheel, x, p = make_wheel(FakeSpinTracker(observed, tracking))
    if slipping:
        wheel.slip_detector.start_slip(1)
    derotate_window(x, p, wheel, CLIPPED._replace(force_clipped=0.2 * force_clipped))
    assert (wheel.angle_losses, wheel.angle_initialised) == (losses, not losses)


def test_lever_arm_sigma_after_clipping_is_at_least_the_previous_one_or_four_millimetres() -> None:
    before = {LEVER_ARM_X: 0.003, LEVER_ARM_Y: 0.01}
    for sigma_while_clipped, after in ((0.001, (0.003, 0.004)), (0.02, (0.02, 0.02))):
        wheel, x, p = make_wheel(FakeSpinTracker(False))
        for entry, sigma in before.items():
            p[wheel.columns[entry], wheel.columns[entry]] = sigma**2
        derotate_window(x, p, wheel, CLIPPED)
        for entry in before:
            p[wheel.columns[entry], wheel.columns[entry]] = sigma_while_clipped**2
        derotate_window(x, p, wheel, CLIPPED)
        derotate_window(x, p, wheel, IN_RANGE)
        sigmas = [math.sqrt(p[wheel.columns[entry], wheel.columns[entry]]) for entry in before]
        assert sigmas == pytest.approx(after)
        # The sigma is restored only once: what is learnt later is kept.
        p[wheel.columns[LEVER_ARM_X], wheel.columns[LEVER_ARM_X]] = 1e-8
        derotate_window(x, p, wheel, IN_RANGE)
        assert p[wheel.columns[LEVER_ARM_X], wheel.columns[LEVER_ARM_X]] == 1e-8


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("slope", [0.0, -20.0])
def test_an_angle_is_reset_if_gravity_disagrees_in_three_consecutive_windows(
    slope: float, sign: float
) -> None:
    """The limit is one radian from the direction for a braking wheel.

    A reset adds the length of one turn along the course to the position sigma.
    """
    for deviation, is_reset in ((0.97, False), (1.03, True)):
        wheel, x, p = make_wheel(FakeSpinTracker(True, slope=slope))
        columns = wheel.columns
        angle = 0.7
        x[columns[WHEEL_ANGLE]], x[columns[HEADING]] = angle, 0.6
        rate = 30.0
        force = WINDOW_S * complex(G, slope * R) * cmath.exp(1j * sign * deviation)
        window = Window(
            spin=rate * WINDOW_S,
            spin_clipped=1.0,
            force=force * cmath.exp(-1j * (angle + 0.5 * rate * WINDOW_S)),
        )
        before = p.copy()
        for _ in range(2):
            assert reset_misaligned_angle(x, p, wheel, window) == []
        # A window that agrees, or one without observed gravity, restarts the count.
        upright = window._replace(force=window.force * cmath.exp(-1j * sign * deviation))
        for observed, interruption in ((True, upright), (False, window)):
            wheel.spin_tracker.is_observed = observed
            assert reset_misaligned_angle(x, p, wheel, interruption) == []
            wheel.spin_tracker.is_observed = True
            for _ in range(2):
                assert reset_misaligned_angle(x, p, wheel, window) == []
        assert np.array_equal(p, before) and wheel.angle_losses == 0
        assert reset_misaligned_angle(x, p, wheel, window) == ([columns[WHEEL_ANGLE]] if is_reset else [])
        assert wheel.angle_losses == is_reset
        assert x[columns[WHEEL_ANGLE]] == pytest.approx(angle - sign * deviation * is_reset)
        if is_reset:
            assert p[columns[WHEEL_ANGLE], columns[WHEEL_ANGLE]] == WHEEL_ANGLE.prior**2
            assert np.count_nonzero(p[columns[WHEEL_ANGLE]]) == 1
            xy, turn_length = (
                [columns[X], columns[Y]],
                2.0 * math.pi * R * np.array([math.cos(0.6), math.sin(0.6)]),
            )
            added = (p - before)[np.ix_(xy, xy)]
            assert added == pytest.approx(np.outer(turn_length, turn_length))
            # The next reset needs three windows again.
            x[columns[WHEEL_ANGLE]] = angle
            assert [len(reset_misaligned_angle(x, p, wheel, window)) for _ in range(3)] == [0, 0, 1]


@pytest.mark.parametrize("at_begin", [True, False])
def test_a_wheel_with_a_clipped_gyro_initialises_angle_and_excess_rate_from_gravity(at_begin: bool) -> None:
    wheel, x, p = make_wheel()
    wheel.angle_initialised, windows = False, rolling_windows(60.0, 10.0)[:8]
    for window in windows:
        wheel.gather_gravity(window)
    excess, angle = wheel.columns[RATE_BEYOND_RANGE], wheel.columns[WHEEL_ANGLE]
    assert wheel.initialise_angle(x, p, at_begin) == [angle, excess] and wheel.angle_initialised
    t = 0.0 if at_begin else 0.8
    assert x[excess] == pytest.approx(60.0 - LIMIT + 10.0 * (0.05 if at_begin else 0.75), abs=0.05)
    truth = 0.4 + 60.0 * t + 5.0 * t * t
    assert cmath.phase(cmath.exp(1j * (x[angle] - truth))) == pytest.approx(0.0, abs=0.02)
    assert (p[excess, excess], p[angle, angle]) == (1.0, WHEEL_ANGLE.prior**2)
    # The tracker starts from the window before the next; its slope is not known yet.
    assert (wheel.spin_tracker.excess, wheel.spin_tracker.slope) == (x[excess], 0.0)
    wheel.drop_angle()
    for window in rolling_windows(60.0, gravity=0.0)[:8]:
        wheel.gather_gravity(window)
    assert wheel.initialise_angle(x, p, at_begin) == [] and not wheel.angle_initialised
