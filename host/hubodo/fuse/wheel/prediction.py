"""What is expected of a window before its rows are worked in: stillness, speed, yaw rate."""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel.entries import (
    EXCESS,
    GYRO_BIAS_X,
    GYRO_BIAS_Y,
    GYRO_BIAS_Z,
    GYRO_SCALE_Z,
    SLOPE,
    SPEED,
    WHEEL_ANGLE,
    YAW_RATE,
    Columns,
)
from hubodo.fuse.wheel.measurements import WindowNoise, forward, zero_velocity
from hubodo.fuse.wheel.silence import agility, window_walk
from hubodo.fuse.wheel.state import UNHEARD, renew
from hubodo.fuse.wheel.stillness import Stillness
from hubodo.fuse.wheel.update import Pairs
from hubodo.fuse.wheel.window import WINDOW

_SPEED_STEP, _YAW_STEP = 0.5, 0.5
"""m/s and rad/s by which speed and yaw rate may step from window to window.

So far that what is measured decides. Where neither is, both wander as silence.py has it. Estimated.
"""

_HARDEST = 5.0
"""m/s²; no wheel drives or brakes a vehicle harder.

Half of gravity, the grip of a good tyre on a dry road.
"""


def each_still(pairs: Pairs, x: list[float], p: Array) -> list[Stillness]:
    """The stillness of each wheel; x, p: states and covariance, for the biases."""
    found = []
    for wheel, window in pairs:
        at = wheel.at
        spin, bx, by = at[GYRO_BIAS_Z], at[GYRO_BIAS_X], at[GYRO_BIAS_Y]
        sigma = math.sqrt(max(p.item(spin, spin), p.item(bx, bx), p.item(by, by)))
        found.append(wheel.rest.stillness(window, x[spin], complex(x[bx], x[by]), sigma))
    return found


def least_still(each: Sequence[Stillness], lost: Sequence[bool]) -> Stillness:
    """That of the wheel that is least still.

    One that spins by itself, or hangs in the air, has no say: while all do, the vehicle is taken to move.
    """
    return min((still for still, away in zip(each, lost, strict=True) if not away), default=Stillness.MOVING)


class Prediction:
    """Takes states and covariance to a window, both in place.

    renewed: the states that were begun anew, without memory. carried: derivatives (n,) of the speed by the
    states before, where the accelerometers carried it, else None.
    """

    def __init__(self, columns: Columns, noise: WindowNoise) -> None:
        self._at, self._noise = columns.vehicle, noise
        self._felt: tuple[float, float, Array] | None = None
        self.renewed: list[int] = []
        self.carried: Array | None = None

    def predict(
        self,
        x: list[float],
        p: Array,
        pairs: Pairs,
        stillness: Stillness,
        carry: bool,
        told: bool,
        fastest: float,
    ) -> None:
        """carry: whether the speed goes on with what the accelerometers feel, and with that alone.

        told: whether another odometer tells what the wheels do. fastest: m/s, that the vehicle has gone.
        """
        self.renewed, self.carried = [], None
        if carry:
            self._carry_speed(x, p, pairs, fastest)
        elif stillness is Stillness.MOVING:
            self._free_rates(x, p, pairs, told, fastest)
        else:
            self._stand(x, p, stillness)

    def forget(self) -> None:
        """What was felt in the window before: another one comes next."""
        self._felt = None

    def _free_rates(self, x: list[float], p: Array, pairs: Pairs, told: bool, fastest: float) -> None:
        """Speed goes on with the mean forward acceleration that is felt; the rest is noise."""
        speed, yaw_rate = self._at[SPEED], self._at[YAW_RATE]
        force = _forward_force(pairs, x)
        self._felt = None
        if force is not None:
            force -= x[self._at[SLOPE]]
            x[speed] += min(_HARDEST, max(-_HARDEST, force)) * WINDOW
        heard = [wheel for wheel, window in pairs if window.missing < UNHEARD]
        shows_turning = told or len(heard) == 2 or any(wheel.joined for wheel in heard)
        along, turning = _SPEED_STEP**2, _YAW_STEP**2
        if not shows_turning:
            free_along, turning = window_walk(agility(fastest))
            along = along if heard or told else free_along
        p[speed, speed] += along
        p[yaw_rate, yaw_rate] += turning

    def _carry_speed(self, x: list[float], p: Array, pairs: Pairs, fastest: float) -> None:
        """Speed as the forward force makes it, with what that owes to slope, wheel angle and biases.

        Speeds are means of a window, so half of the gain is of the window before.
        """
        speed, yaw_rate = self._at[SPEED], self._at[YAW_RATE]
        now = self._feel(x, pairs)
        before, self._felt = self._felt or now, now
        if now is None or before is None:
            p[speed, speed] += _SPEED_STEP**2
        else:
            most = _HARDEST * WINDOW
            x[speed] += min(most, max(-most, 0.5 * (before[0] + now[0])))
            by = 0.5 * (before[2] + now[2])
            by[speed] += 1.0
            row = by.dot(p)
            p[speed, :] = row
            p[:, speed] = row
            p[speed, speed] = row.dot(by) + 0.5 * (before[1] + now[1])
            self.carried = by
        # Where the angle of no wheel is known, nothing shows the yaw rate.
        shown = any(wheel.joined and window.missing < UNHEARD for wheel, window in pairs)
        p[yaw_rate, yaw_rate] += _YAW_STEP**2 if shown else window_walk(agility(fastest))[1]

    def _feel(self, x: list[float], pairs: Pairs) -> tuple[float, float, Array] | None:
        """m/s by which the vehicle becomes faster, its variance, and its derivatives by the states, (n,).

        Mean of the wheels whose accelerometers tell it; None where none does.
        """
        gain, variance, by, count = 0.0, 0.0, np.zeros(len(x)), 0
        for wheel, window in pairs:
            if not (wheel.joined and wheel.part) or window.missing > 0.0 or not forward.usable(window):
                continue
            wheel.view.look(x, window, resting=False, gyro_noise=wheel.rest.noise)
            residual, noise, derivatives = forward.measure(wheel.view, self._noise)
            gain += residual + wheel.geometry.radius * wheel.view.change
            variance += noise
            for entry, value in derivatives.items():
                by[wheel.at[entry]] -= value
            count += 1
        return (gain / count, variance / count**2, by / count) if count else None

    def _stand(self, x: list[float], p: Array, stillness: Stillness) -> None:
        """Speed and yaw rate of a vehicle that stands.

        They are free in each window, so that what is measured takes the place of what was believed.
        """
        self._felt = None
        for residual, variance, derivatives in zero_velocity.measure(x, self._at, stillness):
            for entry in derivatives:
                place = self._at[entry]
                x[place] += residual
                renew(p, place, variance)
                self.renewed.append(place)


def _forward_force(pairs: Pairs, x: list[float]) -> float | None:
    """Mean specific force, m/s², that accelerometers feel along the vehicle's forward axis.

    None where no accelerometer is usable.
    """
    total, count = 0.0, 0
    for wheel, window in pairs:
        if wheel.joined and wheel.part and window.missing == 0.0 and window.force_clipped == 0.0:
            at = wheel.at
            rate = window.spin / WINDOW
            if not window.all_clipped:
                rate = (rate - x[at[GYRO_BIAS_Z]]) / (1.0 + x[at[GYRO_SCALE_Z]])
            rate += x[at[EXCESS]]
            angle = x[at[WHEEL_ANGLE]] + 0.5 * rate * WINDOW
            total += (window.force * cmath.exp(1j * angle)).imag / WINDOW
            count += 1
    return total / count if count else None
