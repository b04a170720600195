"""The rate beyond the range of a clipped gyro as a state: reset, extrapolated, discarded with the angle."""

from __future__ import annotations

import cmath
import math
from typing import Any

import numpy as np
import pytest

from hubodo.fuse.wheel.config import WheelConfig, WheelNode
from hubodo.fuse.wheel.entries import HEADING, LEVER_ARM_X, LEVER_ARM_Y, RATE_BEYOND_RANGE, WHEEL_ANGLE, X, Y
from hubodo.fuse.wheel.rate_beyond_range import derotate_window, reset_misaligned_angle
from hubodo.fuse.wheel.spin_search import rederotate_window
from hubodo.fuse.wheel.state_vector import initial_state
from hubodo.fuse.wheel.window import WINDOW_S, Window
from wheel_windows import LIMIT, G, R, rolling_windows

MAX_RATE_CHANGE = 3.0 * WINDOW_S / R
"""Largest change of the spin rate from window to window, rad/s."""


class FakeSpinTracker:
    """A spin tracker with given outputs that records the calls."""

    def __init__(
        self, observed: bool, tracking: bool = True, excess: float = 12.0, slope: float = -4.0
    ) -> None:
        self.is_observed, self.is_tracking, self.excess, self.slope = observed, tracking, excess, slope
        self.gravity_angle: float | None = None
        self.unobserved_windows = 0
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


def test_a_rate_that_no_axis_shows_spreads_like_braking_that_lasts() -> None:
    """The sigma after k windows is k steps of hard braking, not √k, up to 70 rad/s."""
    wheel, x, p = make_wheel(FakeSpinTracker(False))
    column = wheel.columns[RATE_BEYOND_RANGE]
    for count in range(1, 401):
        wheel.spin_tracker.unobserved_windows = count
        derotated, _ = derotate_window(x, p, wheel, CLIPPED._replace(force_clipped=1.0))
        assert derotated.blind_windows == count
        if count == 30:
            # Each window adds (2 k + 1) squared steps.
            assert math.sqrt(p[column, column]) == pytest.approx(MAX_RATE_CHANGE * math.sqrt(30 * 32))
    assert 70.0 <= math.sqrt(p[column, column]) < 73.0


@pytest.mark.parametrize(("count", "losses"), [(5, 0), (6, 1)])
def test_the_angle_is_lost_after_half_a_second_without_gravity_in_any_axis(count: int, losses: int) -> None:
    wheel, x, p = make_wheel(FakeSpinTracker(False))
    wheel.spin_tracker.unobserved_windows = count
    derotate_window(x, p, wheel, CLIPPED._replace(force_clipped=1.0))
    assert (wheel.counts.angle_losses, wheel.angle_initialised) == (losses, not losses)


@pytest.mark.parametrize(("variance", "losses"), [(0.79, 0), (0.83, 1)])
@pytest.mark.parametrize("cross", [0.2, -0.2])
def test_an_angle_sigma_of_three_priors_at_mid_window_drops_the_angle(
    variance: float, losses: int, cross: float
) -> None:
    """Angle at the start and half a window of the excess rate, with their correlation."""
    wheel, x, p = make_wheel(FakeSpinTracker(False))
    angle, excess = wheel.columns[WHEEL_ANGLE], wheel.columns[RATE_BEYOND_RANGE]
    p[excess, excess], p[angle, excess], p[excess, angle] = 4.0, cross, cross
    p[angle, angle] = variance - WINDOW_S * cross - 0.25 * WINDOW_S**2 * (4.0 + MAX_RATE_CHANGE**2)
    derotate_window(x, p, wheel, CLIPPED)
    assert (wheel.counts.angle_losses, wheel.angle_initialised) == (losses, not losses)


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
    assert (wheel.counts.angle_losses, wheel.angle_initialised) == (losses, not losses)


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
    for deviation, is_reset in ((0.87, False), (0.93, True)):
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
        assert np.array_equal(p, before) and wheel.counts.angle_losses == 0
        assert reset_misaligned_angle(x, p, wheel, window) == ([columns[WHEEL_ANGLE]] if is_reset else [])
        assert wheel.counts.angle_losses == is_reset
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
    assert (p[excess, excess], p[angle, angle]) == ((0.15 / R) ** 2, WHEEL_ANGLE.prior**2)
    # The tracker starts from the window before the next; its slope is not known yet.
    assert (wheel.spin_tracker.excess, wheel.spin_tracker.slope) == (x[excess], 0.0)
    wheel.drop_angle()
    for window in rolling_windows(60.0, gravity=0.0)[:8]:
        wheel.gather_gravity(window)
    assert wheel.initialise_angle(x, p, at_begin) == [] and not wheel.angle_initialised
