"""How the speed goes on from window to window, and where gravity shows that a wheel is."""

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
from hubodo.fuse.wheel.window import EMPTY_WINDOW, WINDOW_S, Window

FORWARD = 0.4
# A wheel that stands with its node upright feels gravity along x, and 0.4 m/s² of braking along y.
SOUND = Window(
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


def gained(angle_known: bool = True, best: WheelMode = WheelMode.ROLLING, **flags: float) -> float:
    """m/s that the speed gained in a window."""
    begin = initial_state(WheelConfig(0.15, 0.5, {"left": WheelNode("left", "left")}))
    (wheel,) = begin.wheels
    wheel.angle_initialised, wheel.best_mode = angle_known, best
    x, place = list(begin.x), begin.columns.vehicle[SPEED]
    pairs = ((wheel, SOUND._replace(**flags)),)
    noise = SimpleNamespace()
    MotionPrediction(begin.columns, noise).predict(  # type: ignore[arg-type]
        x, np.array(begin.p), pairs, MotionState.MOVING, False, False, 1.0
    )
    return x[place] - begin.x[place]


def test_a_sound_accelerometer_carries_the_speed() -> None:
    assert gained() == pytest.approx(FORWARD * WINDOW_S)


@pytest.mark.parametrize(
    "unsound",
    [{"angle_known": False}, {"best": WheelMode.DISABLED}, {"missing": 0.01}, {"force_clipped": 0.01}],
)
def test_one_that_is_not_sound_carries_nothing(unsound: dict[str, float]) -> None:
    assert gained(**unsound) == 0.0  # type: ignore[arg-type]


GRAVITY, SPIN = 9.80665, 3.0


def rolling(number: int, begin: float = 0.7, camber: float = 0.0, **changes: float) -> Window:
    """A window of a wheel that rolls evenly: its angle was `begin` at 0 s, and the carrier goes along."""
    middle = SPIN * (number + 0.5) * WINDOW_S
    return Window(
        number=number,
        spin=SPIN * WINDOW_S,
        force=GRAVITY * WINDOW_S * cmath.rect(np.cos(camber), -(begin + middle)),
        axial=GRAVITY * WINDOW_S * np.sin(camber),
        clock_angle=middle,
        **changes,
    )


def a_wheel(side: str = "left"):  # type: ignore[no-untyped-def]
    """(wheel, its states, their covariance)."""
    begin = initial_state(WheelConfig(0.15, 0.5, {side: WheelNode(side, "left")}))  # type: ignore[arg-type]
    return begin.wheels[0], list(begin.x), begin.p.copy()


def after_a_gap(number: int):  # type: ignore[no-untyped-def]
    """A wheel whose angle is known, heard again in the window of that number: 0.6 s are missing."""
    wheel, x, p = a_wheel()
    wheel.gather_gravity(rolling(0))
    wheel.initialise_angle(x, p, True)
    for before in range(1, number):
        wheel.gather_gravity(rolling(before))
    wheel.gather_gravity(rolling(number, missing=0.6))
    return wheel


@pytest.mark.parametrize("begin", [0.7, -2.9, 3.1])
@pytest.mark.parametrize("windows", [1, 10])
@pytest.mark.parametrize("side", ["left", "right"])
def test_the_angle_of_a_wheel_and_its_lean_are_read_from_gravity(
    side: str, windows: int, begin: float
) -> None:
    for at_begin, turned in ((True, 4 * SPIN * WINDOW_S), (False, (4 + windows) * SPIN * WINDOW_S)):
        wheel, x, p = a_wheel(side)
        for number in range(4, 4 + windows):
            wheel.gather_gravity(rolling(number, begin, 0.05))
        assert wheel.alignment_count == windows and not wheel.angle_initialised
        p += 0.3
        assert wheel.initialise_angle(x, p, at_begin) == [wheel.columns[WHEEL_ANGLE]]
        off = cmath.phase(cmath.exp(1j * (x[wheel.columns[WHEEL_ANGLE]] - begin - turned)))
        assert off == pytest.approx(0.0, abs=1e-9)
        assert abs(x[wheel.columns[WHEEL_ANGLE]]) <= np.pi
        assert x[wheel.columns[CAMBER]] == pytest.approx(0.05 * wheel.geometry.side, abs=1e-9)
        assert wheel.angle_initialised
        place = wheel.columns[WHEEL_ANGLE]
        assert np.count_nonzero(p[place]) == np.count_nonzero(p[:, place]) == 1
        assert p[place, place] == WHEEL_ANGLE.prior**2


@pytest.mark.parametrize(("jumps", "lost"), [(0.0, 0), (0.1, 0), (-0.1, 0), (2.0, 1), (-2.0, 1)])
def test_gravity_that_lies_elsewhere_after_a_gap_says_that_the_angle_was_lost(
    jumps: float, lost: int
) -> None:
    wheel = after_a_gap(41)
    assert wheel.missing_windows == 1
    for number in range(42, 120):
        wheel.gather_gravity(rolling(number, 0.7 + jumps))
    assert (wheel.angle_losses, wheel.angle_initialised) == (lost, not lost)
    wheel.gather_gravity(EMPTY_WINDOW)
    assert not wheel.angle_initialised and wheel.missing_windows == 2


@pytest.mark.parametrize("clipped", ["spin_clipped", "force_clipped"])
def test_a_window_that_was_cut_off_says_nothing_of_where_gravity_lies(clipped: str) -> None:
    wheel = after_a_gap(40)
    for number in range(41, 200):
        wheel.gather_gravity(rolling(number, 2.7, **({clipped: 0.5} if number < 80 else {})))
    assert (wheel.angle_losses, wheel.angle_initialised) == (0, True)


def test_a_bump_in_one_of_the_three_windows_after_a_gap_costs_no_angle() -> None:
    wheel = after_a_gap(40)
    for number in range(41, 60):
        wheel.gather_gravity(rolling(number, 0.7 + 2.0 * (number == 41)))
    assert (wheel.angle_losses, wheel.angle_initialised) == (0, True)


def test_a_wheel_that_changes_sides_touches_the_road_on_the_other() -> None:
    wheel, *_ = a_wheel()
    seen = wheel.geometry.contact_y
    wheel.swap_side()
    assert wheel.geometry.contact_y == wheel.view.geometry.contact_y == -seen != 0.0


def test_a_wheel_counts_what_it_has_turned_and_how_upright_it_was() -> None:
    """A node upside down sees gravity from below."""
    wheel, *_ = a_wheel()
    wheel.angle_initialised = True
    for number in range(50):
        wheel.count_window(rolling(number), SPIN, 0.7 + SPIN * number * WINDOW_S)
    assert (wheel.upright_count, wheel.upright_sum) == (50, pytest.approx(50.0))
    assert wheel.turned_angle == wheel.net_angle == pytest.approx(50 * SPIN * WINDOW_S)
    for number in range(10):
        wheel.count_window(rolling(number), -SPIN, 0.7 + np.pi + 2.0 * SPIN * (number + 0.5) * WINDOW_S)
    assert wheel.turned_angle == pytest.approx(60 * SPIN * WINDOW_S)
    assert wheel.net_angle == pytest.approx(40 * SPIN * WINDOW_S)
    assert wheel.upright_count == 60 and wheel.clipped_windows == 0
    wheel.count_window(rolling(0, force_clipped=0.1), SPIN, 0.7)
    wheel.count_window(rolling(0), 0.99, 0.7)
    wheel.angle_initialised = False
    wheel.count_window(rolling(0, spin_clipped=0.1), SPIN, 0.7)
    assert wheel.upright_count == 60 and wheel.clipped_windows == 1


@pytest.mark.parametrize(
    ("changes", "rolls"),
    [
        ({}, True),
        ({"angle_initialised": False}, False),
        ({"best_mode": WheelMode.DISTRUSTED_SPEED}, False),
        ({"is_slipping": True}, False),
    ],
)
def test_only_a_wheel_that_is_known_trusted_and_on_the_road_tells_the_speed(
    changes: dict[str, bool], rolls: bool
) -> None:
    wheel, *_ = a_wheel()
    wheel.angle_initialised = True
    vars(wheel).update(changes)
    assert (wheel.mode(rolling(0)) is WheelMode.ROLLING) == rolls
    assert wheel.mode(EMPTY_WINDOW) is not WheelMode.ROLLING
