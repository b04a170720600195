"""Which measurements of a window count: clipped channels, gaps, wheels that are not believed."""

import cmath
import math

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import norm

from hubodo.earth import STANDARD_GRAVITY
from hubodo.fuse.wheel.config import WheelConfig, WheelNode
from hubodo.fuse.wheel.entries import CAMBER, GYRO_BIAS_X, SPEED, YAW_RATE
from hubodo.fuse.wheel.measurement_update import MeasurementUpdate, UpdateResult
from hubodo.fuse.wheel.measurements import BETWEEN_WHEELS, MEASUREMENTS
from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.mounting_check import inflate_outlier_variances, track_width_test
from hubodo.fuse.wheel.state_vector import InitialState, initial_state
from hubodo.fuse.wheel.wheel import WheelMode
from hubodo.fuse.wheel.window import WINDOW_S, Window

ROWS, ROWS_BETWEEN = len(MEASUREMENTS), len(BETWEEN_WHEELS)
"""Rows of one wheel, and those of them that compare wheels."""

CHANNELS = {"yaw", "roll", "forward", "sideways", "rolling"}
"""Measurements whose channels are listed in this file; an added one has its own `usable`."""

UPRIGHT = cmath.exp(-0.25j)
"""Gravity as a wheel feels it that stood upright when the window began and turns by half a radian in it."""

SOUND = Window(
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


def _begun(*names: str) -> tuple[MeasurementUpdate, InitialState]:
    """An update and states in which all wheels are believed, at the speed that SOUND rolls with."""
    nodes = {name: WheelNode(name, "left") for name in names}  # type: ignore[arg-type]
    config = WheelConfig(0.15, 0.5, nodes)
    begin = initial_state(config)
    for wheel in begin.wheels:
        wheel.angle_initialised = True
    begin.x[begin.columns.vehicle[SPEED]] = 0.75
    return MeasurementUpdate(config, begin.columns), begin


def _work_in(update: MeasurementUpdate, begin: InitialState, *windows: Window) -> UpdateResult:
    pairs = tuple(zip(begin.wheels, windows, strict=True))
    return update.update(list(begin.x), begin.p.copy(), pairs, MotionState.MOVING)


@pytest.mark.parametrize(
    ("flags", "silent"),
    [
        ({}, set()),
        ({"across_clipped": 0.1}, {"yaw", "roll"}),
        ({"force_clipped": 0.1}, {"forward", "sideways"}),
        ({"axial_clipped": 0.1}, {"sideways"}),
        ({"spin_clipped": 0.1}, set()),
        ({"spin_clipped": 1.0, "across_clipped": 0.1}, {"yaw", "roll"}),
    ],
)
def test_a_clipped_channel_silences_what_is_made_of_it_and_nothing_else(
    flags: dict[str, float], silent: set[str]
) -> None:
    window = SOUND._replace(**flags)
    unusable = {one.__name__.rpartition(".")[2] for one in MEASUREMENTS if not one.usable(window)}  # type: ignore[attr-defined]
    assert unusable & CHANNELS == silent
    update, begin = _begun("left")
    assert _work_in(update, begin, window).dof == ROWS - len(unusable)
    # The other wheel's rows stay.
    update, begin = _begun("left", "right")
    assert _work_in(update, begin, window, SOUND).dof == 2 * ROWS - len(unusable)


@pytest.mark.parametrize(("missing", "count"), [(0.0, ROWS), (0.499, ROWS), (0.5, 0), (1.0, 0)])
def test_a_window_that_is_half_a_gap_says_nothing(missing: float, count: int) -> None:
    update, begin = _begun("left")
    assert _work_in(update, begin, SOUND._replace(missing=missing)).dof == count


def test_a_gap_in_a_window_makes_all_its_variances_grow_alike() -> None:
    """By 1 + 1e4 times its share: with states that are known exactly nothing else is in the innovations, and
    none is so large that it loses weight."""
    update, begin = _begun("left")
    begin.p[:] = 0.0
    quiet = SOUND._replace(across=2e-5 + 3e-5j, force=0.97 * UPRIGHT + 0.002j, axial=0.003)
    sound = _work_in(update, begin, quiet)
    assert 0.01 < sound.nis < 9.0
    holed = _work_in(update, begin, quiet._replace(missing=0.3))
    assert sound.nis / holed.nis == pytest.approx(1.0 + 1e4 * 0.3)


@pytest.mark.parametrize(
    ("joined", "trusted", "count"),
    [
        (True, True, 2 * ROWS),
        (False, True, ROWS + ROWS_BETWEEN),
        (True, False, 2 * ROWS - ROWS_BETWEEN),
        (False, False, ROWS),
    ],
)
def test_a_wheel_whose_angle_is_not_known_tells_how_it_rolls_and_one_that_is_distrusted_does_not_give_speed(
    joined: bool, trusted: bool, count: int
) -> None:
    update, begin = _begun("left", "right")
    begin.wheels[1].angle_initialised = joined
    if not trusted:
        begin.wheels[1].best_mode = WheelMode.DISTRUSTED_SPEED
    assert _work_in(update, begin, SOUND, SOUND).dof == count


def test_nothing_heard_changes_nothing() -> None:
    update, begin = _begun("left", "right")
    gone = Window(missing=1.0)
    found = _work_in(update, begin, gone, gone)
    assert found.x == begin.x
    assert found.dof == 0
    assert np.array_equal(found.p, begin.p)


def test_the_silent_rows_are_those_of_their_own_wheel() -> None:
    """A bias is learnt from the wheel whose gyro is sound, and not from the one whose gyro is clipped."""
    update, begin = _begun("left", "right")
    left, right = (wheel.columns[GYRO_BIAS_X] for wheel in begin.wheels)
    found = _work_in(update, begin, SOUND._replace(across_clipped=1.0), SOUND)
    assert found.p[left, left] == pytest.approx(begin.p[left, left], rel=1e-9)
    assert found.p[right, right] < 0.9 * begin.p[right, right]


def test_the_yaw_rate_a_wheel_feels_does_not_depend_on_the_one_believed() -> None:
    """yaws: what the gyros across the axle feel over the window, W / T, upright, of a leaning wheel."""
    update, begin = _begun("left")
    wheel = begin.wheels[0]
    begin.x[wheel.columns[CAMBER]], begin.x[wheel.columns[YAW_RATE]] = 0.4, 0.3
    felt = _work_in(update, begin, SOUND).yaw_rates[0]
    assert felt == pytest.approx((wheel.view.rotation * SOUND.across).real / WINDOW_S / math.cos(0.4))


def test_a_row_that_stands_out_counts_as_three_sigma() -> None:
    """With states that are known exactly rows are independent: the others keep their weight."""
    update, begin = _begun("left")
    begin.p[:] = 0.0
    quiet = SOUND._replace(across=0j, force=STANDARD_GRAVITY * WINDOW_S * UPRIGHT, axial=0.0)
    assert _work_in(update, begin, quiet).nis < 1e-6
    sigma = math.sqrt(1.0 / (_work_in(update, begin, quiet._replace(axial=1e-3)).nis / 1e-6))
    for times, nis in ((2.9, 2.9**2), (5.0, 9.0), (500.0, 9.0)):
        assert _work_in(update, begin, quiet._replace(axial=times * sigma)).nis == pytest.approx(nis)


def test_a_slip_is_laid_to_the_wheel_that_left_the_speed() -> None:
    """Rows of yaw 0 and 1, of rolling 2 and 3; only the wheels' agreement stands out."""
    white, sigma = np.array([0.0, 0.0, 0.5, 6.0]), np.array([1.0, 1.0, 1.0, 0.1])
    compared = ((0, 2), (1, 3))
    for residuals, slipping in (([0.0, 0.0, 0.7, 0.1], 0), ([0.0, 0.0, 0.1, -0.7], 1)):
        wider, found = inflate_outlier_variances(white, sigma, np.array(residuals), np.ones(4), compared)
        assert found == slipping
        expected = np.ones(4)
        expected[2 + slipping] += 0.7**2
        assert wider == pytest.approx(expected)


def test_of_two_yaw_rates_that_disagree_both_lose_weight_alike() -> None:
    """The second is judged given the first, so that it alone stands out: by 6 sigma of 0.1 it takes variance
    until it is 3."""
    white, sigma = np.array([0.0, 6.0, 0.0, 0.0]), np.full(4, 0.1)
    wider, slipping = inflate_outlier_variances(white, sigma, np.zeros(4), np.ones(4), ((0, 2), (1, 3)))
    assert slipping is None
    assert wider == pytest.approx(1.0 + np.array([0.03, 0.03, 0.0, 0.0]))
    alone, _ = inflate_outlier_variances(white, sigma, np.zeros(4), np.ones(4), None)
    assert alone == pytest.approx(1.0 + np.array([0.0, 0.03, 0.0, 0.0]))


@pytest.mark.parametrize("prior", [0.02, 0.1])
def test_a_tape_is_believed_where_care_is_more_likely_by_a_third(prior: float) -> None:
    """By the densities of both priors, where one is 1.26 times the other, and 1.31 times.

    Turns show the track to 0.1 %; a careful tape is good for half a percent, another one for `prior`.
    """
    shown = 0.001**2
    variance = 1.0 / (1.0 / shown + 1.0 / prior**2)
    care, anyhow = norm(scale=math.hypot(0.001, 0.005)), norm(scale=math.hypot(0.001, prior))
    said = []
    for likelier in (1.26, 1.31):
        seen = brentq(lambda x, by=likelier: care.pdf(x) / anyhow.pdf(x) - by, 0.0, 0.05)
        said.append(track_width_test(seen * variance / shown, variance, prior))
    assert said == [math.inf, 0.005**2]


@pytest.mark.parametrize(("turned", "lost"), [(0.0, 0), (0.5, 0), (-0.5, 0), (1.2, 1), (-1.2, 1), (3.1, 1)])
def test_an_angle_is_lost_where_gravity_has_turned_over_a_gap_by_more_than_brakes_tilt_it(
    turned: float, lost: int
) -> None:
    """A wheel that turns half a radian a window, upright at clock angle 1; brakes of 0.8 g tilt it by 0.7."""
    _, begin = _begun("left")
    wheel = begin.wheels[0]

    def heard(window: int, off: float) -> Window:
        angle = 1.0 + 0.5 * window
        return Window(spin=0.5, clock_angle=angle, force=0.98 * cmath.exp(-1j * (angle - 1.0 - off)))

    for number in range(20):
        wheel.gather_gravity(heard(number, 0.0))
    wheel.gather_gravity(Window(missing=0.8))
    for number in range(21, 24):
        assert wheel.angle_initialised and wheel.angle_losses == 0
        wheel.gather_gravity(heard(number, turned))
    assert (wheel.angle_losses, wheel.angle_initialised) == (lost, not lost)
