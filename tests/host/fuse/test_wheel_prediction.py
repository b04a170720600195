"""Speed prediction of one wheel by its accelerometer, and its wheel angle from gravity."""

import cmath
from types import SimpleNamespace

import numpy as np
import pytest

from hubodo.fuse.wheel.config import WheelConfig, WheelNode
from hubodo.fuse.wheel.entries import CAMBER, SPEED, WHEEL_ANGLE
from hubodo.fuse.wheel.motion_prediction import MotionPrediction
from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.state_vector import initial_state
from hubodo.fuse.wheel.wheel import WheelMode
from hubodo.fuse.wheel.wheel_counts import WheelCounts
from hubodo.fuse.wheel.window import EMPTY_WINDOW, WINDOW_S, Window

FORWARD = 0.4
# An upright node at standstill measures gravity along x; 0.4 m/s² of acceleration appears along y.
VALID_WINDOW = Window(
    spin=0.0,
    rate_start=0.0,
    rate_end=0.0,
    across=0j,
    carrier=WINDOW_S + 0j,
    force=(9.8 + 1j * FORWARD) * WINDOW_S,
    axial=0.0,
    raw_across=0j,
    raw_force=(9.8 + 1j * FORWARD) * WINDOW_S,
    axial_variance=0.05,
    rate_carrier=0.0,
    lever=0j,
)


def speed_gain(angle_known: bool = True, best_mode: WheelMode = WheelMode.ROLLING, **flags: float) -> float:
    """Return the predicted speed gain of a window, m/s."""
    initial = initial_state(WheelConfig(0.15, 0.5, {"left": WheelNode("left", "left")}))
    (wheel,) = initial.wheels
    wheel.angle_initialised, wheel.best_mode = angle_known, best_mode
    x, column = list(initial.x), initial.columns.vehicle[SPEED]
    pairs = ((wheel, VALID_WINDOW._replace(**flags)),)
    noise = SimpleNamespace()
    MotionPrediction(initial.columns, noise).predict(  # type: ignore[arg-type]
        x, np.array(initial.p), pairs, MotionState.MOVING, False, False, 1.0
    )
    return x[column] - initial.x[column]


def test_a_valid_accelerometer_propagates_the_speed() -> None:
    assert speed_gain() == pytest.approx(FORWARD * WINDOW_S)


@pytest.mark.parametrize(
    "unusable",
    [{"angle_known": False}, {"best_mode": WheelMode.DISABLED}, {"missing": 0.01}, {"force_clipped": 0.01}],
)
def test_an_unusable_accelerometer_does_not_propagate_the_speed(unusable: dict[str, float]) -> None:
    assert speed_gain(**unusable) == 0.0  # type: ignore[arg-type]


GRAVITY, SPIN = 9.80665, 3.0


def rolling_window(number: int, start_angle: float = 0.7, camber: float = 0.0, **changes: float) -> Window:
    """Return a window of a wheel at constant spin rate with `start_angle` at 0 s; the carrier follows it."""
    middle = SPIN * (number + 0.5) * WINDOW_S
    return Window(
        number=number,
        spin=SPIN * WINDOW_S,
        force=GRAVITY * WINDOW_S * cmath.rect(np.cos(camber), -(start_angle + middle)),
        axial=GRAVITY * WINDOW_S * np.sin(camber),
        clock_angle=middle,
        **changes,
    )


def make_wheel(side: str = "left"):  # type: ignore[no-untyped-def]
    """Return a wheel, its states and their covariance."""
    initial = initial_state(WheelConfig(0.15, 0.5, {side: WheelNode(side, "left")}))  # type: ignore[arg-type]
    return initial.wheels[0], list(initial.x), initial.p.copy()


def wheel_after_gap(number: int):  # type: ignore[no-untyped-def]
    """Return a wheel of known angle in the window of that number, after a gap of 0.6 s."""
    wheel, x, p = make_wheel()
    wheel.gather_gravity(rolling_window(0))
    wheel.initialise_angle(x, p, True)
    for before in range(1, number):
        wheel.gather_gravity(rolling_window(before))
    wheel.gather_gravity(rolling_window(number, missing=0.6))
    return wheel


@pytest.mark.parametrize("start_angle", [0.7, -2.9, 3.1])
@pytest.mark.parametrize("windows", [1, 10])
@pytest.mark.parametrize("side", ["left", "right"])
def test_wheel_angle_and_camber_are_initialised_from_gravity(
    side: str, windows: int, start_angle: float
) -> None:
    for at_begin, turned_angle in ((True, 4 * SPIN * WINDOW_S), (False, (4 + windows) * SPIN * WINDOW_S)):
        wheel, x, p = make_wheel(side)
        for number in range(4, 4 + windows):
            wheel.gather_gravity(rolling_window(number, start_angle, 0.05))
        assert wheel.alignment.count == windows and not wheel.angle_initialised
        p += 0.3
        assert wheel.initialise_angle(x, p, at_begin) == [wheel.columns[WHEEL_ANGLE]]
        angle_error = cmath.phase(
            cmath.exp(1j * (x[wheel.columns[WHEEL_ANGLE]] - start_angle - turned_angle))
        )
        assert angle_error == pytest.approx(0.0, abs=1e-9)
        assert abs(x[wheel.columns[WHEEL_ANGLE]]) <= np.pi
        assert x[wheel.columns[CAMBER]] == pytest.approx(0.05 * wheel.geometry.side, abs=1e-9)
        assert wheel.angle_initialised
        column = wheel.columns[WHEEL_ANGLE]
        assert np.count_nonzero(p[column]) == np.count_nonzero(p[:, column]) == 1
        assert p[column, column] == WHEEL_ANGLE.prior**2


@pytest.mark.parametrize(("jump", "losses"), [(0.0, 0), (0.1, 0), (-0.1, 0), (2.0, 1), (-2.0, 1)])
def test_a_changed_gravity_direction_after_a_gap_drops_the_angle(jump: float, losses: int) -> None:
    wheel = wheel_after_gap(41)
    assert wheel.counts.missing_windows == 1
    for number in range(42, 120):
        wheel.gather_gravity(rolling_window(number, 0.7 + jump))
    assert (wheel.counts.angle_losses, wheel.angle_initialised) == (losses, not losses)
    wheel.gather_gravity(EMPTY_WINDOW)
    assert not wheel.angle_initialised and wheel.counts.missing_windows == 2


@pytest.mark.parametrize("clipped", ["spin_clipped", "force_clipped"])
def test_clipped_windows_are_ignored_in_the_gravity_check(clipped: str) -> None:
    wheel = wheel_after_gap(40)
    for number in range(41, 200):
        wheel.gather_gravity(rolling_window(number, 2.7, **({clipped: 0.5} if number < 80 else {})))
    assert (wheel.counts.angle_losses, wheel.angle_initialised) == (0, True)


def test_a_bump_in_one_of_three_windows_after_a_gap_keeps_the_angle() -> None:
    wheel = wheel_after_gap(40)
    for number in range(41, 60):
        wheel.gather_gravity(rolling_window(number, 0.7 + 2.0 * (number == 41)))
    assert (wheel.counts.angle_losses, wheel.angle_initialised) == (0, True)


def test_swapping_the_side_mirrors_the_contact_point() -> None:
    wheel, *_ = make_wheel()
    contact_y = wheel.geometry.contact_y
    wheel.swap_side()
    assert wheel.geometry.contact_y == wheel.view.geometry.contact_y == -contact_y != 0.0


def test_a_wheel_counts_its_turned_angle_and_upright_windows() -> None:
    """Gravity is reversed in a node that is mounted upside down."""
    counts = WheelCounts()
    for number in range(50):
        counts.add_window(rolling_window(number), SPIN, 0.7 + SPIN * number * WINDOW_S)
    assert (counts.upright_count, counts.upright_sum) == (50, pytest.approx(50.0))
    assert counts.turned_angle == counts.net_angle == pytest.approx(50 * SPIN * WINDOW_S)
    for number in range(10):
        counts.add_window(rolling_window(number), -SPIN, 0.7 + np.pi + 2.0 * SPIN * (number + 0.5) * WINDOW_S)
    assert counts.turned_angle == pytest.approx(60 * SPIN * WINDOW_S)
    assert counts.net_angle == pytest.approx(40 * SPIN * WINDOW_S)
    assert counts.upright_count == 60 and counts.clipped_windows == 0
    counts.add_window(rolling_window(0, force_clipped=0.1), SPIN, 0.7)
    counts.add_window(rolling_window(0), 0.99, 0.7)
    counts.add_window(rolling_window(0, spin_clipped=0.1), SPIN, None)
    assert counts.upright_count == 60 and counts.clipped_windows == 1


@pytest.mark.parametrize(
    ("changes", "is_rolling"),
    [
        ({}, True),
        ({"angle_initialised": False}, False),
        ({"best_mode": WheelMode.DISTRUSTED_SPEED}, False),
        ({"is_slipping": True}, False),
    ],
)
def test_only_a_wheel_of_known_angle_trusted_and_not_slipping_measures_the_speed(
    changes: dict[str, bool], is_rolling: bool
) -> None:
    wheel, *_ = make_wheel()
    wheel.angle_initialised = True
    vars(wheel).update(changes)
    assert (wheel.mode(rolling_window(0)) is WheelMode.ROLLING) == is_rolling
    assert wheel.mode(EMPTY_WINDOW) is not WheelMode.ROLLING
