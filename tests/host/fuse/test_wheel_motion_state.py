"""Standstill: it improves biases only, for any duration and noise; slow driving is no standstill."""

import numpy as np
import pytest
from scipy.signal import lfilter

from generators import wheel_drives
from generators.idling import idling_drive
from generators.standstills import drive_with_standstill
from hubodo.fuse.wheel.motion_state import MotionState, StandstillDetector, long_run_variance
from hubodo.fuse.wheel.track import WheelRun, run_wheel_filter
from hubodo.fuse.wheel.window import WINDOW_S, Window
from repetitions import first_and_more
from wheel_runs import config, end_error, nees, tables

SEED = 12


@pytest.mark.parametrize(
    "duration, where, gyro_noise, idling",
    [
        (40.0, "middle", 0.002, 0.0),
        (40.0, "start", 0.02, 0.0),
        *first_and_more(
            (120.0, "middle", 0.002, 0.03),
            (120.0, "start", 0.002, 0.0),
            (120.0, "middle", 0.02, 0.0),
            (40.0, "start", 0.002, 0.03),
        ),
    ],
)
def test_a_standstill_of_any_length_does_not_degrade_the_track(
    duration: float, where: str, gyro_noise: float, idling: float
) -> None:
    """Each kind of noise at either place and for either duration; `make road` has every combination."""
    drive = drive_with_standstill(SEED, 40.0, duration, where, gyro_noise, idling)
    run = run_wheel_filter(config(drive), tables(drive))
    percent = 100.0 * end_error(drive, run) / drive.length
    print(f"seed {SEED}: {percent:.2f} % off at the end, NEES {nees(drive, run):.1f}")
    # 1 in 10,000 values of chi-square with 3 dof exceeds 21. Loops of 60 m without standstill end with an
    # error of 0.6 %.
    assert percent < 2.0 and nees(drive, run) < 21.0
    assert np.mean(run.track.motion_state == MotionState.STANDSTILL) > 0.5 * duration / run.track.t[-1]


def _slow_manoeuvre(speed: float, yaw_rate: float) -> tuple[wheel_drives.WheelDrive, WheelRun]:
    """Return drive and run: ten seconds of standstill, a minute of a slow manoeuvre, standstill."""
    rng = np.random.default_rng(SEED)
    plan = wheel_drives.legs([(10.0, 0.0, 0.0), (60.0, speed, yaw_rate), (5.0, 0.0, 0.0)])
    drive = wheel_drives.drive(plan, rng)
    return drive, run_wheel_filter(config(drive), tables(drive))


@pytest.mark.parametrize(
    "speed, yaw_rate", [(0.0, 0.03), *first_and_more((0.05, 0.0), (0.0, 0.1), (0.05, 0.03), (0.025, 0.1))]
)
def test_a_slow_manoeuvre_is_not_detected_as_standstill(speed: float, yaw_rate: float) -> None:
    """Turns on the spot and slow curves; the last one turns about the left wheel, which stands still."""
    drive, run = _slow_manoeuvre(speed, yaw_rate)
    heading_error_deg = np.degrees(run.track.heading[-1] - np.interp(run.track.t[-1], drive.t, drive.heading))
    moving = (run.track.t > 11.0) & (run.track.t < 69.0)
    print(f"seed {SEED}: {heading_error_deg:+.2f}° off after {np.degrees(60.0 * yaw_rate):.0f}°")
    assert not np.any(run.track.motion_state[moving] == MotionState.STANDSTILL)
    assert abs(heading_error_deg) < 0.03 * np.degrees(60.0 * yaw_rate) + 1.0
    assert end_error(drive, run) < 0.06 and nees(drive, run) < 21.0


def _window(spin: float = 0.0, across: complex = 0j, force: complex = 9.8j, **changes: float) -> Window:
    """Return a window of constant rates, rad/s, and a constant force, m/s²."""
    return Window(spin=spin * WINDOW_S, raw_across=across * WINDOW_S, raw_force=force * WINDOW_S, **changes)


STANDSTILL, ROCKING, MOVING = MotionState.STANDSTILL, MotionState.ROCKING, MotionState.MOVING
ROCKING_WINDOWS = [_window(force=9.8j + 0.3 * (k % 10 > 4)) for k in range(20)]


def _final_motion_state(
    windows: list[Window], spin_bias: float = 0.0, across_bias: complex = 0j, sigma: float = 0.0
) -> MotionState:
    """Return the motion state after the last window."""
    detector = StandstillDetector()
    return [detector.detect(window, spin_bias, across_bias, sigma) for window in windows][-1]


def test_standstill_is_detected_after_one_second_and_rocking_after_two() -> None:
    assert [_final_motion_state([_window()] * count) for count in (9, 10, 11)] == [
        MOVING,
        STANDSTILL,
        STANDSTILL,
    ]
    assert [_final_motion_state(ROCKING_WINDOWS[:count]) for count in (19, 20)] == [MOVING, ROCKING]


@pytest.mark.parametrize(
    ("windows", "expected"),
    [
        ([_window(spin=0.0049)] * 20, STANDSTILL),
        ([_window(spin=-0.0051)] * 20, ROCKING),
        ([_window(across=0.0049j)] * 20, STANDSTILL),
        ([_window(across=-0.0051)] * 20, ROCKING),
        ([_window(spin=0.0199)] * 20, ROCKING),
        ([_window(across=0.0201)] * 20, MOVING),
        ([_window()] * 19 + [_window(spin=0.009)], STANDSTILL),
        ([_window()] * 19 + [_window(spin=0.05)], ROCKING),
        ([_window(gyro_variance=0.099**2)] * 20, STANDSTILL),
        ([_window(gyro_variance=0.101**2)] * 20, ROCKING),
        ([_window(gyro_variance=0.249**2)] * 20, ROCKING),
        ([_window(gyro_variance=0.251**2)] * 20, MOVING),
        ([_window(force=9.8j + 0.059 * (k > 14)) for k in range(20)], STANDSTILL),
        ([_window(force=9.8j + 0.061 * (k > 14)) for k in range(20)], ROCKING),
        ([_window(force=9.8j - 0.79 * (k > 14)) for k in range(20)], ROCKING),
        ([_window(force=9.8j - 0.81 * (k > 14)) for k in range(20)], MOVING),
        ([_window(force=9.8j - 0.6), *ROCKING_WINDOWS[1:]], MOVING),
        ([_window(force=9.8j - 0.4), *ROCKING_WINDOWS[1:]], ROCKING),
        ([*ROCKING_WINDOWS[:10], _window(missing=0.1), *ROCKING_WINDOWS[10:]], MOVING),
        ([*ROCKING_WINDOWS[:10], _window(spin=0.121), *ROCKING_WINDOWS[10:]], MOVING),
        ([*ROCKING_WINDOWS[:10], _window(spin=-0.121), *ROCKING_WINDOWS[10:]], MOVING),
        ([*ROCKING_WINDOWS[:10], _window(across=0.121j), *ROCKING_WINDOWS[10:]], MOVING),
        ([*ROCKING_WINDOWS[:10], _window(spin=0.119), _window(spin=-0.119), *ROCKING_WINDOWS[10:]], ROCKING),
    ],
)
def test_motion_states_change_at_their_limits(windows: list[Window], expected: MotionState) -> None:
    assert _final_motion_state(windows) == expected


@pytest.mark.parametrize(
    ("rate", "expected"), [(0.034, STANDSTILL), (0.036, ROCKING), (0.049, ROCKING), (0.051, MOVING)]
)
def test_rates_are_corrected_for_bias_and_limits_widened_by_three_bias_sigma(
    rate: float, expected: MotionState
) -> None:
    assert _final_motion_state([_window(spin=0.5 + rate)] * 20, spin_bias=0.5, sigma=0.01) == expected
    assert _final_motion_state([_window(across=0.5j - rate)] * 20, across_bias=0.5j, sigma=0.01) == expected
    assert _final_motion_state([_window(spin=0.12 + rate)] * 20, sigma=0.01) == MOVING
    for deviation, expected_state in ((0.149, ROCKING), (0.151, MOVING)):
        disturbances = [
            _window(spin=deviation),
            _window(spin=-deviation),
            _window(across=deviation),
            _window(across=-deviation),
        ]
        assert (
            _final_motion_state([*ROCKING_WINDOWS[:8], *disturbances, *ROCKING_WINDOWS[:8]], sigma=0.01)
            == expected_state
        )


def test_gyro_noise_is_estimated_at_standstill_from_one_second_earlier() -> None:
    """Alternating rates with steps of 2 s on one of three axes give a variance of 2 s² / 3, and no mean."""
    detector, alternating = StandstillDetector(), [_window(spin=0.03 * (-1) ** k) for k in range(10)]
    assert [detector.detect(w, 0.0, 0j, 0.0) for w in alternating][-1] == STANDSTILL
    assert detector.noise == pytest.approx(0.06**2 / 6.0)
    assert detector.force == pytest.approx(9.8j)
    for _ in range(9):
        detector.detect(_window(), 0.0, 0j, 0.0)
    assert detector.noise == pytest.approx(0.06**2 / 6.0)
    detector.detect(_window(), 0.0, 0j, 0.0)
    assert detector.noise < 0.06**2 / 6.0
    detector.clear()
    assert detector.force == 0.0 and detector.detect(_window(), 0.0, 0j, 0.0) == MOVING
    for window in [*[_window()] * 20, *[_window(spin=0.02)] * 10, *alternating]:
        detector.detect(window, 0.0, 0j, 0.0)
    assert detector.noise > 1e-5, "noise of this standstill, not of the one before the wheel crept"
    detector.clear()
    for window in alternating:
        detector.detect(window, 0.0, 0j, 0.0)
    assert detector.noise == pytest.approx(0.06**2 / 6.0)


def test_initial_noise_is_estimated_only_if_all_first_windows_are_quiet() -> None:
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


def test_the_variance_of_correlated_forces_is_that_of_their_sum():
    """An autoregressive process of correlation r has the long-run variance σ² (1 + r) / (1 - r)."""
    rng, r, n = np.random.default_rng(11), 0.6, 4000
    innovations = np.sqrt(1.0 - r * r) * (rng.standard_normal(n) + 1j * rng.standard_normal(n))
    forces = lfilter([1.0], [1.0, -r], innovations)
    assert long_run_variance(forces.tolist()) == pytest.approx((1.0 + r) / (1.0 - r), rel=0.3)
    assert long_run_variance((innovations / np.sqrt(1.0 - r * r)).tolist()) == pytest.approx(1.0, rel=0.3)


def test_a_shaking_engine_leaves_neither_false_biases_nor_false_slips():
    """Seed 7029 with 1.8 m/s²: 144 % of the distance when the resting accelerometers were trusted."""
    _, drive = idling_drive(7029)
    run = run_wheel_filter(config(drive), tables(drive))
    assert end_error(drive, run) < 0.02 * drive.length
    assert not any(wheel.slip_detector.slips for wheel in run.filter.core.wheels)
