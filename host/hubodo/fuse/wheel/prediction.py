"""What is expected of a window before its rows are worked in: stillness, speed, yaw rate."""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel.entries import (
    GYRO_BIAS_X,
    GYRO_BIAS_Y,
    GYRO_BIAS_Z,
    GYRO_SCALE_Z,
    RATE_BEYOND_RANGE,
    SLOPE,
    SPEED,
    WHEEL_ANGLE,
    YAW_RATE,
    StateLayout,
)
from hubodo.fuse.wheel.measurement_update import WheelWindows
from hubodo.fuse.wheel.measurements import WindowNoise, forward, zero_velocity
from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.outage_model import free_motion_variances, vehicle_agility
from hubodo.fuse.wheel.state import MAX_MISSING_SHARE, reset_state
from hubodo.fuse.wheel.window import WINDOW_S

_SPEED_STEP, _YAW_STEP = 0.5, 0.5
"""m/s and rad/s by which speed and yaw rate may step from window to window.

So far that what is measured decides. Where neither is, both wander as silence.py has it. Estimated.
"""

_HARDEST = 5.0
"""m/s²; no wheel drives or brakes a vehicle harder.

Half of gravity, the grip of a good tyre on a dry road.
"""


def detect_wheel_motion(pairs: WheelWindows, x: list[float], p: Array) -> list[MotionState]:
    """The stillness of each wheel; x, p: states and covariance, for the biases."""
    found = []
    for wheel, window in pairs:
        at = wheel.columns
        spin, bx, by = at[GYRO_BIAS_Z], at[GYRO_BIAS_X], at[GYRO_BIAS_Y]
        sigma = math.sqrt(max(p.item(spin, spin), p.item(bx, bx), p.item(by, by)))
        found.append(wheel.standstill.detect(window, x[spin], complex(x[bx], x[by]), sigma))
    return found


def vehicle_motion(each: Sequence[MotionState], lost: Sequence[bool]) -> MotionState:
    """That of the wheel that is least still.

    One that spins by itself, or hangs in the air, has no say: while all do, the vehicle is taken to move.
    """
    return min(
        (still for still, away in zip(each, lost, strict=True) if not away), default=MotionState.MOVING
    )


class MotionPrediction:
    """Takes states and covariance to a window, both in place.

    renewed: the states that were begun anew, without memory. carried: derivatives (n,) of the speed by the
    states before, where the accelerometers carried it, else None.
    """

    def __init__(self, columns: StateLayout, noise: WindowNoise) -> None:
        self._at, self._noise = columns.vehicle, noise
        self._felt: tuple[float, float, Array] | None = None
        self.reset_states: list[int] = []
        self.speed_row: Array | None = None

    def predict(
        self,
        x: list[float],
        p: Array,
        pairs: WheelWindows,
        stillness: MotionState,
        carry: bool,
        told: bool,
        fastest: float,
    ) -> None:
        """carry: whether the speed goes on with what the accelerometers feel, and with that alone.

        told: whether another odometer tells what the wheels do. fastest: m/s, that the vehicle has gone.
        """
        self.reset_states, self.speed_row = [], None
        if carry:
            self._carry_speed(x, p, pairs, fastest)
        elif stillness is MotionState.MOVING:
            self._free_rates(x, p, pairs, told, fastest)
        else:
            self._stand(x, p, stillness)

    def clear_force(self) -> None:
        """What was felt in the window before: another one comes next."""
        self._felt = None

    def _free_rates(self, x: list[float], p: Array, pairs: WheelWindows, told: bool, fastest: float) -> None:
        """Speed goes on with the mean forward acceleration that is felt; the rest is noise."""
        speed, yaw_rate = self._at[SPEED], self._at[YAW_RATE]
        force = _forward_force(pairs, x)
        self._felt = None
        if force is not None:
            force -= x[self._at[SLOPE]]
            x[speed] += min(_HARDEST, max(-_HARDEST, force)) * WINDOW_S
        heard = [wheel for wheel, window in pairs if window.missing < MAX_MISSING_SHARE]
        shows_turning = told or len(heard) == 2 or any(wheel.angle_initialised for wheel in heard)
        along, turning = _SPEED_STEP**2, _YAW_STEP**2
        if not shows_turning:
            free_along, turning = free_motion_variances(vehicle_agility(fastest))
            along = along if heard or told else free_along
        p[speed, speed] += along
        p[yaw_rate, yaw_rate] += turning

    def _carry_speed(self, x: list[float], p: Array, pairs: WheelWindows, fastest: float) -> None:
        """Speed as the forward force makes it, with what that owes to slope, wheel angle and biases.

        Speeds are means of a window, so half of the gain is of the window before.
        """
        speed, yaw_rate = self._at[SPEED], self._at[YAW_RATE]
        now = self._feel(x, pairs)
        before, self._felt = self._felt or now, now
        if now is None or before is None:
            p[speed, speed] += _SPEED_STEP**2
        else:
            most = _HARDEST * WINDOW_S
            x[speed] += min(most, max(-most, 0.5 * (before[0] + now[0])))
            by = 0.5 * (before[2] + now[2])
            by[speed] += 1.0
            row = by.dot(p)
            p[speed, :] = row
            p[:, speed] = row
            p[speed, speed] = row.dot(by) + 0.5 * (before[1] + now[1])
            self.speed_row = by
        # Where the angle of no wheel is known, nothing shows the yaw rate.
        shown = any(wheel.angle_initialised and window.missing < MAX_MISSING_SHARE for wheel, window in pairs)
        p[yaw_rate, yaw_rate] += _YAW_STEP**2 if shown else free_motion_variances(vehicle_agility(fastest))[1]

    def _feel(self, x: list[float], pairs: WheelWindows) -> tuple[float, float, Array] | None:
        """m/s by which the vehicle becomes faster, its variance, and its derivatives by the states, (n,).

        Mean of the wheels whose accelerometers tell it; None where none does.
        """
        gain, variance, by, count = 0.0, 0.0, np.zeros(len(x)), 0
        for wheel, window in pairs:
            if (
                not (wheel.angle_initialised and wheel.is_used)
                or window.missing > 0.0
                or not forward.usable(window)
            ):
                continue
            wheel.view.linearise(x, window, resting=False, gyro_noise=wheel.standstill.noise)
            residual, noise, derivatives = forward.measure(wheel.view, self._noise)
            gain += residual + wheel.geometry.radius * wheel.view.axle_rate_change
            variance += noise
            for entry, value in derivatives.items():
                by[wheel.columns[entry]] -= value
            count += 1
        return (gain / count, variance / count**2, by / count) if count else None

    def _stand(self, x: list[float], p: Array, stillness: MotionState) -> None:
        """Speed and yaw rate of a vehicle that stands.

        They are free in each window, so that what is measured takes the place of what was believed.
        """
        self._felt = None
        for residual, variance, derivatives in zero_velocity.measure(x, self._at, stillness):
            for entry in derivatives:
                place = self._at[entry]
                x[place] += residual
                reset_state(p, place, variance)
                self.reset_states.append(place)


def _forward_force(pairs: WheelWindows, x: list[float]) -> float | None:
    """Mean specific force, m/s², that accelerometers feel along the vehicle's forward axis.

    None where no accelerometer is usable.
    """
    total, count = 0.0, 0
    for wheel, window in pairs:
        if (
            wheel.angle_initialised
            and wheel.is_used
            and window.missing == 0.0
            and window.force_clipped == 0.0
        ):
            at = wheel.columns
            rate = window.spin / WINDOW_S
            if not window.all_clipped:
                rate = (rate - x[at[GYRO_BIAS_Z]]) / (1.0 + x[at[GYRO_SCALE_Z]])
            rate += x[at[RATE_BEYOND_RANGE]]
            angle = x[at[WHEEL_ANGLE]] + 0.5 * rate * WINDOW_S
            total += (window.force * cmath.exp(1j * angle)).imag / WINDOW_S
            count += 1
    return total / count if count else None
