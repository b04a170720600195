"""Standing still teaches biases and nothing else, however long, however noisy; slow driving is no rest."""

import numpy as np
import pytest

from generators import wheel_drives
from generators.standstills import drive_with_standstill
from hubodo.fuse.wheel.motion_state import MotionState, StandstillDetector
from hubodo.fuse.wheel.track import WheelRun, run_wheel_filter
from hubodo.fuse.wheel.window import WINDOW_S, Window
from wheel_runs import config, end_error, nees, tables

SEED = 12


@pytest.mark.parametrize("where", ["start", "middle"])
@pytest.mark.parametrize("rest", [40.0, 120.0])
@pytest.mark.parametrize("gyro_noise, idling", [(0.002, 0.0), (0.02, 0.0), (0.002, 0.03)])
def test_a_rest_costs_nothing(rest: float, where: str, gyro_noise: float, idling: float) -> None:
    drive = drive_with_standstill(SEED, 40.0, rest, where, gyro_noise, idling)
    found = run_wheel_filter(config(drive), tables(drive))
    percent = 100.0 * end_error(drive, found) / drive.length
    print(f"seed {SEED}: {percent:.2f} % off at the end, NEES {nees(drive, found):.1f}")
    # Chi-square of 3: 1 in 10,000 lies above 21. Loops of 60 m without a rest end 0.6 % off.
    assert percent < 2.0 and nees(drive, found) < 21.0
    assert np.mean(found.track.motion_state == MotionState.STANDSTILL) > 0.5 * rest / found.track.t[-1]


def _slow(speed: float, yaw_rate: float) -> tuple[wheel_drives.WheelDrive, WheelRun]:
    """Ten seconds of rest, then a minute of a slow manoeuvre, then rest."""
    rng = np.random.default_rng(SEED)
    plan = wheel_drives.legs([(10.0, 0.0, 0.0), (60.0, speed, yaw_rate), (5.0, 0.0, 0.0)])
    drive = wheel_drives.drive(plan, rng)
    return drive, run_wheel_filter(config(drive), tables(drive))


@pytest.mark.parametrize(
    "speed, yaw_rate", [(0.0, 0.1), (0.0, 0.03), (0.05, 0.03), (0.05, 0.0), (0.025, 0.1)]
)
def test_a_slow_manoeuvre_is_no_rest(speed: float, yaw_rate: float) -> None:
    """Pivots, creeping in curves; the last turns about the left wheel, which stands."""
    drive, found = _slow(speed, yaw_rate)
    turned = np.degrees(found.track.heading[-1] - np.interp(found.track.t[-1], drive.t, drive.heading))
    moving = (found.track.t > 11.0) & (found.track.t < 69.0)
    print(f"seed {SEED}: {turned:+.2f}° off after {np.degrees(60.0 * yaw_rate):.0f}°")
    assert not np.any(found.track.motion_state[moving] == MotionState.STANDSTILL)
    assert abs(turned) < 0.03 * np.degrees(60.0 * yaw_rate) + 1.0
    assert end_error(drive, found) < 0.06 and nees(drive, found) < 21.0


def _window(spin: float = 0.0, across: complex = 0j, force: complex = 9.8j, **changes: float) -> Window:
    """Of steady rates, rad/s, and a steady force, m/s²."""
    return Window(spin=spin * WINDOW_S, raw_across=across * WINDOW_S, raw_force=force * WINDOW_S, **changes)


STILL, ROCKED, MOVED = MotionState.STANDSTILL, MotionState.ROCKING, MotionState.MOVING
ROCKING = [_window(force=9.8j + 0.3 * (k % 10 > 4)) for k in range(20)]


def _ends(
    windows: list[Window], spin_bias: float = 0.0, across_bias: complex = 0j, sigma: float = 0.0
) -> MotionState:
    """How still it is at the end."""
    detector = StandstillDetector()
    return [detector.detect(window, spin_bias, across_bias, sigma) for window in windows][-1]


def test_a_rest_takes_a_second_and_hands_on_the_rims_two() -> None:
    assert [_ends([_window()] * count) for count in (9, 10, 11)] == [MOVED, STILL, STILL]
    assert [_ends(ROCKING[:count]) for count in (19, 20)] == [MOVED, ROCKED]


@pytest.mark.parametrize(
    ("windows", "found"),
    [
        ([_window(spin=0.0049)] * 20, STILL),
        ([_window(spin=-0.0051)] * 20, ROCKED),
        ([_window(across=0.0049j)] * 20, STILL),
        ([_window(across=-0.0051)] * 20, ROCKED),
        ([_window(spin=0.0199)] * 20, ROCKED),
        ([_window(across=0.0201)] * 20, MOVED),
        ([_window()] * 19 + [_window(spin=0.009)], STILL),
        ([_window()] * 19 + [_window(spin=0.05)], ROCKED),
        ([_window(gyro_variance=0.099**2)] * 20, STILL),
        ([_window(gyro_variance=0.101**2)] * 20, ROCKED),
        ([_window(gyro_variance=0.249**2)] * 20, ROCKED),
        ([_window(gyro_variance=0.251**2)] * 20, MOVED),
        ([_window(force=9.8j + 0.059 * (k > 14)) for k in range(20)], STILL),
        ([_window(force=9.8j + 0.061 * (k > 14)) for k in range(20)], ROCKED),
        ([_window(force=9.8j - 0.79 * (k > 14)) for k in range(20)], ROCKED),
        ([_window(force=9.8j - 0.81 * (k > 14)) for k in range(20)], MOVED),
        ([_window(force=9.8j - 0.6), *ROCKING[1:]], MOVED),
        ([_window(force=9.8j - 0.4), *ROCKING[1:]], ROCKED),
        ([*ROCKING[:10], _window(missing=0.1), *ROCKING[10:]], MOVED),
        ([*ROCKING[:10], _window(spin=0.121), *ROCKING[10:]], MOVED),
        ([*ROCKING[:10], _window(spin=-0.121), *ROCKING[10:]], MOVED),
        ([*ROCKING[:10], _window(across=0.121j), *ROCKING[10:]], MOVED),
        ([*ROCKING[:10], _window(spin=0.119), _window(spin=-0.119), *ROCKING[10:]], ROCKED),
    ],
)
def test_stillness_ends_at_its_limits(windows: list[Window], found: MotionState) -> None:
    assert _ends(windows) == found


@pytest.mark.parametrize(
    ("rate", "found"), [(0.034, STILL), (0.036, ROCKED), (0.049, ROCKED), (0.051, MOVED)]
)
def test_rates_are_less_their_biases_and_three_sigmas_of_these_are_left_to_them(
    rate: float, found: MotionState
) -> None:
    assert _ends([_window(spin=0.5 + rate)] * 20, spin_bias=0.5, sigma=0.01) == found
    assert _ends([_window(across=0.5j - rate)] * 20, across_bias=0.5j, sigma=0.01) == found
    assert _ends([_window(spin=0.12 + rate)] * 20, sigma=0.01) == MOVED
    for off, still in ((0.149, ROCKED), (0.151, MOVED)):
        turns = [_window(spin=off), _window(spin=-off), _window(across=off), _window(across=-off)]
        assert _ends([*ROCKING[:8], *turns, *ROCKING[:8]], sigma=0.01) == still


def test_what_is_random_in_rates_is_told_from_a_turn_and_kept_as_it_was_a_second_ago() -> None:
    """Steps of 2 s of three independent axes: a variance of 2 s² / 3 of each, none of it in the mean."""
    detector, to_and_fro = StandstillDetector(), [_window(spin=0.03 * (-1) ** k) for k in range(10)]
    assert [detector.detect(w, 0.0, 0j, 0.0) for w in to_and_fro][-1] == STILL
    assert detector.noise == pytest.approx(0.06**2 / 6.0)
    assert detector.force == pytest.approx(9.8j)
    for _ in range(9):
        detector.detect(_window(), 0.0, 0j, 0.0)
    assert detector.noise == pytest.approx(0.06**2 / 6.0)
    detector.detect(_window(), 0.0, 0j, 0.0)
    assert detector.noise < 0.06**2 / 6.0
    detector.clear()
    assert detector.force == 0.0 and detector.detect(_window(), 0.0, 0j, 0.0) == MOVED
    for window in [*[_window()] * 20, *[_window(spin=0.02)] * 10, *to_and_fro]:
        detector.detect(window, 0.0, 0j, 0.0)
    assert detector.noise > 1e-5, "of this rest, and not of that before the wheel crept"
    detector.clear()
    for window in to_and_fro:
        detector.detect(window, 0.0, 0j, 0.0)
    assert detector.noise == pytest.approx(0.06**2 / 6.0)


def test_the_first_windows_tell_the_noise_where_all_of_them_are_quiet() -> None:
    quiet = [_window(spin=0.02 * (-1) ** k, across=0.5j + np.sqrt(5e-4) * (-1) ** k) for k in range(6)]
    for windows, noise in (
        (quiet, 0.06**2 / 6.0),
        ([*quiet, _window(gyro_variance=0.11**2)], 0.0),
        ([*quiet, _window(missing=0.01)], 0.0),
        (quiet[:1], 0.0),
    ):
        detector = StandstillDetector()
        detector.estimate_initial_noise(windows)
        assert detector.noise == pytest.approx(noise)
