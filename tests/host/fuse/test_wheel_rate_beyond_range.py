"""The spin that a clipped gyro does not show: found where gravity turns, carried as a state, given up."""

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


def rolled(
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
    """Windows of a wheel that turns at spin + slope t, rad/s, begun at an angle of 0.4 at 0 s.

    Its gyro stands at its limit; the hub moves with R times its rate, so that what is felt is gravity and
    that, turned backwards; and what arm and bias of the accelerometers add in axes of the node.
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
def test_excess_and_its_slope_turn_a_window_as_a_gyro_that_shows_them(slope: float) -> None:
    rng = np.random.default_rng(3)
    t = np.arange(-0.05, 0.6, 1.0 / 208.0)
    gyro, accel = rng.standard_normal((2, len(t), 3))
    gyro[:, 2] += 20.0
    shown = gyro.copy()
    # Of the window from 0.3 to 0.4 s, at whose middle the excess is 7 rad/s.
    shown[:, 2] += 7.0 + slope * (t - 0.35)
    plain, whole = (WindowBuilder("left", 0.0, 0.1).add_many(t, w, accel)[3] for w in (gyro, shown))
    made = rederotate_window(plain, 7.0, slope)
    for name in ("carrier", "force", "across", "rate_carrier", "lever"):
        # The straight lines between samples turn otherwise than a parabola, by slope dt² / 8 at most.
        assert abs(getattr(made, name) - getattr(whole, name)) < 3e-4 * max(1.0, abs(getattr(whole, name)))
    for name in ("rate_start", "rate_end"):
        assert getattr(made, name) - getattr(plain, name) == pytest.approx(
            getattr(whole, name) - getattr(plain, name) - 7.0
        )
    assert made.spin == plain.spin
    untold = plain._replace(samples=None)
    assert rederotate_window(untold, 7.0) is untold


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("spin", "slope"), [(34.6, 0.0), (50.13, 7.7), (90.4, 20.9), (90.4, -20.9), (130.0, 32.0), (230.0, 0.0)]
)
def test_a_search_finds_spin_and_angle_at_both_ends(spin: float, slope: float, sign: float) -> None:
    windows = rolled(sign * spin, sign * slope, rate_hz=208.0)[2:9]
    found = find_spin(windows, R)
    assert found is not None
    begin, end = 0.2, 0.9
    for at, angle in ((begin, found.start_angle), (end, found.end_angle)):
        truth = 0.4 + sign * (spin * at + 0.5 * slope * at * at)
        assert cmath.phase(cmath.exp(1j * (angle - truth))) == pytest.approx(0.0, abs=0.012)
    for middle, excess in ((begin + 0.05, found.excess), (end - 0.05, found.excess_end)):
        assert excess == pytest.approx(sign * (spin + slope * middle - LIMIT), abs=0.04)


@pytest.mark.parametrize(("share", "seen"), [(0.57, False), (0.63, True), (1.47, True), (1.53, False)])
def test_what_turns_is_gravity_from_six_tenths_to_one_and_a_half_of_it(share: float, seen: bool) -> None:
    windows = rolled(60.0, gravity=share * G)[:8]
    assert (find_spin(windows, R) is not None) == seen
    follower = SpinTracker(R)
    follower.initialise(60.0 - LIMIT, 0.0)
    for window in windows:
        follower.track_window(window, 0j, 0j)
    assert follower.is_observed == seen


def test_fewer_than_a_quarter_of_a_second_of_samples_tell_nothing() -> None:
    """Of 104 a second; those whose force was cut off do not count, nor windows that are a gap in part."""
    windows = rolled(60.0, rate_hz=104.0)
    assert find_spin(windows[:2], R) is None
    assert find_spin(windows[:3], R) is not None
    gaps = [window._replace(missing=0.1) for window in windows[2:]]
    assert find_spin([*windows[:2], *gaps], R) is None
    assert find_spin(rolled(60.0, accel_limit=0.6 * G)[:8], R) is None
    assert find_spin([window._replace(samples=None) for window in windows], R) is None
    # One window with enough of them may do.
    found = find_spin(rolled(80.0, rate_hz=416.0)[4:5], R)
    assert found is not None and found.excess == pytest.approx(80.0 - LIMIT, abs=1.0)


@pytest.mark.parametrize("spin", [35.0, 60.0])
def test_a_tone_has_the_size_that_least_squares_give_it_beside_bias_and_lever_arm(spin: float) -> None:
    """However little it turns, so that a polynomial of time has a part of it."""
    taken = _Samples.of(rolled(spin, rate_hz=208.0, bias=BIAS, arm=ARM)[3:5])
    assert taken is not None
    found = taken.without(3).best(np.array([spin - LIMIT]), np.zeros(1))
    columns = np.column_stack(
        [np.exp(-1j * (taken.carried + (spin - LIMIT) * taken.t)), taken.t[:, None] ** np.arange(3)]
    )
    fitted = np.linalg.lstsq(columns, taken.force, rcond=None)[0][0]
    assert abs(fitted) == pytest.approx(G)
    assert found.amplitude == pytest.approx(fitted)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("slope", "off"), [(0.0, 6.0), (0.0, -6.0), (20.3, 0.0), (-20.3, 0.0), (31.0, 0.0), (-31.0, 0.0)]
)
def test_a_spin_that_is_followed_is_that_of_gravity_with_arm_and_bias_taken_out(
    slope: float, off: float, sign: float
) -> None:
    """Begun with a slope of none, and an excess that is off by as much as brakes make of it."""
    spin = 80.0
    windows = rolled(sign * spin, sign * slope, arm=ARM, bias=BIAS, rate_hz=208.0)
    follower = SpinTracker(R)
    follower.initialise(sign * (spin - LIMIT) + off, 0.0)
    assert not follower.is_tracking
    for window in windows[:8]:
        follower.track_window(window, ARM, BIAS)
        assert follower.is_tracking
    middle = 0.75
    assert follower.is_observed
    assert follower.excess == pytest.approx(sign * (spin + slope * middle - LIMIT), abs=0.1)
    assert follower.slope == pytest.approx(sign * slope, abs=0.6)
    follower.pause()
    assert not follower.is_tracking and not follower.is_observed


def test_an_arm_that_is_not_taken_out_of_a_spin_that_changes_makes_it_wrong() -> None:
    windows = rolled(80.0, -20.0, arm=3.0 * ARM, rate_hz=208.0)
    off = []
    for arm in (3.0 * ARM, -3.0 * ARM):
        follower = SpinTracker(R)
        follower.initialise(80.0 - LIMIT, -20.0)
        for window in windows[:8]:
            follower.track_window(window, arm, 0j)
        off.append(abs(follower.excess - (80.0 - 20.0 * 0.75 - LIMIT)))
    assert off[0] < 0.05 < off[1]


def test_where_nothing_turns_a_spin_goes_on_and_of_four_windows_changes_half_as_fast_each_time() -> None:
    windows = rolled(60.0, gravity=0.0)
    follower = SpinTracker(R)
    follower.initialise(20.0, 8.0)
    excess, slope = 20.0, 8.0
    for number, window in enumerate(windows[:6], start=1):
        follower.track_window(window, 0j, 0j)
        excess += slope * WINDOW_S
        slope *= 0.5 if number >= 4 else 1.0
        assert (follower.excess, follower.slope, follower.is_observed) == (
            pytest.approx(excess),
            slope,
            False,
        )
    follower.pause()
    assert not follower.is_tracking and follower.excess == pytest.approx(excess)
    follower.track_window(windows[6], 0j, 0j)
    follower.record_unclipped(Window(rate_start=3.0, rate_end=4.5))
    assert not follower.is_tracking and not follower.is_observed
    assert (follower.excess, follower.slope) == (0.0, pytest.approx(15.0))


STEP = 3.0 * WINDOW_S / R
"""rad/s by which the spin may change from window to window."""


class Following:
    """A follower that says what it is told to."""

    def __init__(self, seen: bool, following: bool = True, excess: float = 12.0, slope: float = -4.0) -> None:
        self.is_observed, self.is_tracking, self.excess, self.slope = seen, following, excess, slope
        self.did: list[str] = []
        self.asked: tuple[Any, ...] = ()

    def track_window(self, *args: Any) -> None:
        self.did.append("follow")
        self.asked = args

    def record_unclipped(self, window: Window) -> None:
        self.did.append("roll")

    def pause(self) -> None:
        self.did.append("rest")


def a_wheel(follower: Following | None = None):  # type: ignore[no-untyped-def]
    """(wheel that is known, its states, their covariance)."""
    begin = initial_state(WheelConfig(R, 0.6, {"left": WheelNode("left", "left")}))
    (wheel,) = begin.wheels
    wheel.angle_initialised = True
    if follower is not None:
        wheel.spin_tracker = follower  # type: ignore[assignment]
    p = begin.p + 0.01 * np.ones_like(begin.p)
    p[wheel.columns[RATE_BEYOND_RANGE], :] = p[:, wheel.columns[RATE_BEYOND_RANGE]] = 0.0
    return wheel, list(begin.x), p


SHOWN = Window(spin=2.0, force=0.9 + 0.1j)
CLIPPED = SHOWN._replace(spin_clipped=1.0)


def test_a_window_that_shows_its_spin_stays_as_it_is() -> None:
    wheel, x, p = a_wheel(Following(False))
    before = p.copy()
    assert derotate_window(x, p, wheel, SHOWN) == (SHOWN, [])
    assert wheel.spin_tracker.did == ["roll"] and wheel.angle_initialised
    assert np.array_equal(p, before)


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_beyond_the_limit_for_less_than_a_window_a_spin_is_not_far_beyond(share: float) -> None:
    wheel, x, p = a_wheel(Following(False))
    place = wheel.columns[RATE_BEYOND_RANGE]
    x[place], p[place, :], p[:, place] = 9.0, 0.2, 0.2
    window = rolled(60.0)[3]._replace(spin_clipped=share)
    made, renewed = derotate_window(x, p, wheel, window)
    assert renewed == [place] and x[place] == 0.0
    assert p[place, place] == pytest.approx((STEP * share) ** 2)
    assert np.count_nonzero(p[place]) == np.count_nonzero(p[:, place]) == (share > 0.0)
    assert made == rederotate_window(window, 0.0)


@pytest.mark.parametrize(("following", "joined"), [(True, False), (False, True)])
def test_a_wheel_that_was_followed_has_turned_on_where_it_is_not_heard(following: bool, joined: bool) -> None:
    wheel, x, p = a_wheel(Following(False, following))
    derotate_window(x, p, wheel, Window(missing=1.0))
    assert wheel.angle_initialised == joined and wheel.spin_tracker.did == ["rest"]


def test_a_spin_that_gravity_shows_is_begun_anew_about_it() -> None:
    wheel, x, p = a_wheel(Following(True))
    place = wheel.columns[RATE_BEYOND_RANGE]
    p[place, :], p[:, place] = 0.01, 0.01
    x[wheel.columns[LEVER_ARM_X]], x[wheel.columns[LEVER_ARM_Y]] = 0.02, -0.03
    window = rolled(60.0)[3]
    made, renewed = derotate_window(x, p, wheel, window)
    assert renewed == [place] and x[place] == 12.0
    assert p[place, place] == pytest.approx((0.15 / R) ** 2)
    assert np.count_nonzero(p[place]) == 1
    assert made == rederotate_window(window, 12.0, -4.0)
    assert wheel.spin_tracker.asked == (window, 0.02 - 0.03j, 0j)


def test_a_spin_that_it_does_not_show_goes_on_as_it_changed_or_as_it_was_found() -> None:
    for known, expected in ((0.0, 12.0), (0.5, 7.0 - 0.4)):
        wheel, x, p = a_wheel(Following(False))
        place = wheel.columns[RATE_BEYOND_RANGE]
        x[place], p[place, place] = 7.0, known
        _, renewed = derotate_window(x, p, wheel, CLIPPED)
        assert renewed == [] and x[place] == pytest.approx(expected)
        assert p[place, place] == pytest.approx(known + STEP**2)


@pytest.mark.parametrize(("share", "lost"), [(0.98, 0), (1.02, 1)])
@pytest.mark.parametrize("cross", [0.2, -0.2])
def test_an_angle_that_may_be_off_by_a_radian_in_the_middle_of_the_window_is_lost(
    share: float, lost: int, cross: float
) -> None:
    """Of the angle at its beginning and half a window of the excess together."""
    wheel, x, p = a_wheel(Following(False))
    angle, place = wheel.columns[WHEEL_ANGLE], wheel.columns[RATE_BEYOND_RANGE]
    p[place, place], p[angle, place], p[place, angle] = 4.0, cross, cross
    p[angle, angle] = share - WINDOW_S * cross - 0.25 * WINDOW_S**2 * (4.0 + STEP**2)
    derotate_window(x, p, wheel, CLIPPED)
    assert (wheel.angle_losses, wheel.angle_initialised) == (lost, not lost)


@pytest.mark.parametrize(
    ("spins", "blind", "seen", "following", "lost"),
    [
        (False, True, False, False, 0),
        (True, False, False, True, 0),
        (True, False, True, False, 1),
        (True, True, False, True, 1),
        (True, True, True, True, 0),
    ],
)
def test_of_a_wheel_that_spins_by_itself_the_angle_is_lost_where_nothing_shows_it(
    spins: bool, blind: bool, seen: bool, following: bool, lost: int
) -> None:
    wheel, x, p = a_wheel(Following(seen, following))
    if spins:
        wheel.slip_detector.start_slip(1)
    derotate_window(x, p, wheel, CLIPPED._replace(force_clipped=0.2 * blind))
    assert (wheel.angle_losses, wheel.angle_initialised) == (lost, not lost)


def test_a_lever_arm_is_as_unsure_after_a_clipped_time_as_before_but_for_four_millimetres() -> None:
    before = {LEVER_ARM_X: 0.003, LEVER_ARM_Y: 0.01}
    for learnt, after in ((0.001, (0.003, 0.004)), (0.02, (0.02, 0.02))):
        wheel, x, p = a_wheel(Following(False))
        for entry, sigma in before.items():
            p[wheel.columns[entry], wheel.columns[entry]] = sigma**2
        derotate_window(x, p, wheel, CLIPPED)
        for entry in before:
            p[wheel.columns[entry], wheel.columns[entry]] = learnt**2
        derotate_window(x, p, wheel, CLIPPED)
        derotate_window(x, p, wheel, SHOWN)
        found = [math.sqrt(p[wheel.columns[entry], wheel.columns[entry]]) for entry in before]
        assert found == pytest.approx(after)
        # Only once: what is learnt later is kept.
        p[wheel.columns[LEVER_ARM_X], wheel.columns[LEVER_ARM_X]] = 1e-8
        derotate_window(x, p, wheel, SHOWN)
        assert p[wheel.columns[LEVER_ARM_X], wheel.columns[LEVER_ARM_X]] == 1e-8


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("slope", [0.0, -20.0])
def test_an_angle_is_begun_anew_where_gravity_was_elsewhere_for_three_windows(
    slope: float, sign: float
) -> None:
    """By more than a radian of where it is for a wheel that brakes; the way may be a turn off along the
    course."""
    for off, found in ((0.97, False), (1.03, True)):
        wheel, x, p = a_wheel(Following(True, slope=slope))
        at = wheel.columns
        angle = 0.7
        x[at[WHEEL_ANGLE]], x[at[HEADING]] = angle, 0.6
        rate = 30.0
        felt = WINDOW_S * complex(G, slope * R) * cmath.exp(1j * sign * off)
        window = Window(
            spin=rate * WINDOW_S,
            spin_clipped=1.0,
            force=felt * cmath.exp(-1j * (angle + 0.5 * rate * WINDOW_S)),
        )
        before = p.copy()
        for _ in range(2):
            assert reset_misaligned_angle(x, p, wheel, window) == []
        # One that agrees begins the count anew, as does one in which gravity is not seen.
        upright = window._replace(force=window.force * cmath.exp(-1j * sign * off))
        for seen, between in ((True, upright), (False, window)):
            wheel.spin_tracker.is_observed = seen
            assert reset_misaligned_angle(x, p, wheel, between) == []
            wheel.spin_tracker.is_observed = True
            for _ in range(2):
                assert reset_misaligned_angle(x, p, wheel, window) == []
        assert np.array_equal(p, before) and wheel.angle_losses == 0
        assert reset_misaligned_angle(x, p, wheel, window) == ([at[WHEEL_ANGLE]] if found else [])
        assert wheel.angle_losses == found
        assert x[at[WHEEL_ANGLE]] == pytest.approx(angle - sign * off * found)
        if found:
            assert p[at[WHEEL_ANGLE], at[WHEEL_ANGLE]] == WHEEL_ANGLE.prior**2
            assert np.count_nonzero(p[at[WHEEL_ANGLE]]) == 1
            places, way = [at[X], at[Y]], 2.0 * math.pi * R * np.array([math.cos(0.6), math.sin(0.6)])
            grown = (p - before)[np.ix_(places, places)]
            assert grown == pytest.approx(np.outer(way, way))
            # From there on it takes three windows again.
            x[at[WHEEL_ANGLE]] = angle
            assert [len(reset_misaligned_angle(x, p, wheel, window)) for _ in range(3)] == [0, 0, 1]


@pytest.mark.parametrize("at_begin", [True, False])
def test_a_wheel_whose_gyro_is_clipped_joins_with_the_spin_that_gravity_shows(at_begin: bool) -> None:
    wheel, x, p = a_wheel()
    wheel.angle_initialised, windows = False, rolled(60.0, 10.0)[:8]
    for window in windows:
        wheel.gather_gravity(window)
    place, angle = wheel.columns[RATE_BEYOND_RANGE], wheel.columns[WHEEL_ANGLE]
    assert wheel.initialise_angle(x, p, at_begin) == [angle, place] and wheel.angle_initialised
    at = 0.0 if at_begin else 0.8
    assert x[place] == pytest.approx(60.0 - LIMIT + 10.0 * (0.05 if at_begin else 0.75), abs=0.05)
    truth = 0.4 + 60.0 * at + 5.0 * at * at
    assert cmath.phase(cmath.exp(1j * (x[angle] - truth))) == pytest.approx(0.0, abs=0.02)
    assert (p[place, place], p[angle, angle]) == (1.0, WHEEL_ANGLE.prior**2)
    # What is found is that of the window before the next, and nobody knows yet how it changes.
    assert (wheel.spin_tracker.excess, wheel.spin_tracker.slope) == (x[place], 0.0)
    wheel.drop_angle()
    for window in rolled(60.0, gravity=0.0)[:8]:
        wheel.gather_gravity(window)
    assert wheel.initialise_angle(x, p, at_begin) == [] and not wheel.angle_initialised
