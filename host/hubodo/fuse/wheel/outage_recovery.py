"""Recovery from an outage of all wheels: rollback once their angles are known, then replay."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from hubodo.arrays import Array
from hubodo.fuse.wheel.axle_rate import mean_axle_rate
from hubodo.fuse.wheel.entries import GYRO_SCALE_ACROSS, WHEEL_ANGLE
from hubodo.fuse.wheel.free_motion import MotionSigmas
from hubodo.fuse.wheel.motion_model import HeadingErrorInflation
from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.outage_bridge import MAX_BRIDGED_OUTAGE_S, OutageEnd
from hubodo.fuse.wheel.records import WheelWindows
from hubodo.fuse.wheel.thresholds import DETECTION_WINDOWS
from hubodo.fuse.wheel.wheel import MAX_WHEEL_SKEW_WINDOWS, Wheel, WheelMode
from hubodo.fuse.wheel.window import WINDOW_S, Window


class _Step(NamedTuple):
    """A step after the outage, with windows as received."""

    number: int
    windows: WheelWindows
    motion_states: Sequence[MotionState]


@dataclass
class OutageRecovery:
    """An outage whose motion may still be determined.

    Attributes
    ----------
    number : number of its last window.
    seconds : length of the outage.
    motion_sigmas : of the vehicle at the start of the outage.
    x, p : states and covariance at the start of the outage.
    inflation : heading error inflation at the start of the outage.
    steps : steps since the end of the outage.
    """

    number: int
    seconds: float
    motion_sigmas: MotionSigmas
    x: list[float]
    p: Array
    inflation: HeadingErrorInflation
    steps: list[_Step] = field(default_factory=list)

    @staticmethod
    def is_possible(wheels: Sequence[Wheel], seconds: float) -> bool:
        """Return True if the wheel angles were known and the wheels rolled at the start of an outage."""
        return seconds <= MAX_BRIDGED_OUTAGE_S and all(
            wheel.windows_without_angle <= MAX_WHEEL_SKEW_WINDOWS
            and wheel.best_mode is WheelMode.ROLLING
            and not wheel.slip_detector.is_slipping
            for wheel in wheels
        )

    def add(self, number: int, windows: WheelWindows, motion_states: Sequence[MotionState]) -> None:
        """Add a step after the outage, with its windows as received."""
        self.steps.append(_Step(number, windows, motion_states))

    def is_over(self) -> bool:
        """Return True if gravity has not shown the wheel angles in time, or a gyro clips."""
        return len(self.steps) > DETECTION_WINDOWS or any(
            window.spin_clipped > 0.0 for step in self.steps[-1:] for _, window in step.windows
        )

    def outage_end(self, x: Sequence[float]) -> OutageEnd | None:
        """Return wheels and vehicle at the end of the outage; None if no step has windows of all wheels.

        x: states at the end of the last step, with wheel angles that gravity has just shown.
        """
        first = next(
            (step for step in self.steps if all(window.missing == 0.0 for _, window in step.windows)), None
        )
        if first is None:
            return None
        angles = []
        for index, (wheel, _) in enumerate(first.windows):
            turned, rate = 0.0, _axle_rate(x, *first.windows[index])
            for step in self.steps:
                window = step.windows[index][1]
                turned += (rate if window.missing > 0.0 else _axle_rate(x, wheel, window)) * WINDOW_S
            angles.append(x[wheel.columns[WHEEL_ANGLE]] - turned)
        speeds = [wheel.geometry.radius * _axle_rate(x, wheel, window) for wheel, window in first.windows]
        contacts = [wheel.geometry.contact_y for wheel, _ in first.windows]
        if len(speeds) == 2:
            yaw_rate = (speeds[1] - speeds[0]) / (contacts[0] - contacts[1])
        else:
            yaw_rate = _yaw_rate(x, *first.windows[0], angles[0])
        return OutageEnd(tuple(angles), speeds[0] + contacts[0] * yaw_rate, yaw_rate)


def _axle_rate(x: Sequence[float], wheel: Wheel, window: Window) -> float:
    return mean_axle_rate(x, wheel.columns, window).rate


def _yaw_rate(x: Sequence[float], wheel: Wheel, window: Window, angle: float) -> float:
    """Return the yaw rate of the vehicle, rad/s, by the gyros across the axle; angle: rad, at its start."""
    states = list(x)
    states[wheel.columns[WHEEL_ANGLE]] = angle
    wheel.view.linearise(states, window, is_stationary=False)
    scale = (1.0 + x[wheel.columns[GYRO_SCALE_ACROSS]]) * WINDOW_S * wheel.view.camber_cos
    return wheel.view.across.real / scale - wheel.geometry.ground_rate
