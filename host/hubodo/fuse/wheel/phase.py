"""What one wheel's window says about wheel angle, yaw, speed and the node's errors; with the Jacobian.

The node is taken to face left. Complex numbers are x + iy of node axes; turned by e^(i theta), theta the
wheel angle, their real part points up and their imaginary part forward (the model's README). With p the mean
wheel rate, R the radius, T the window, lambda +1 on the left wheel and -1 on the right one:

    p = (int gz / T - b_z) / (1 + k) + u - lambda r sin(camber)
    theta_m = theta + p T / 2
    across:  Re[(W - b E - tau G) e^(i theta_m)] = (1 + s) cos(camber) r T + b_r T      yaw
             Im[the same] = 0                                                             no roll
    force:   Im[(F - a E - rho L) e^(i theta_m)] = R (w_1 - w_0) + n T                    forward
    axial:   int (az - l_x ax - l_y ay) = (lambda g sin(camber) + cos(camber) r R w + a_z) T
                                            + 2 w rho . int (gx, gy)                         sideways
    rolling: R (1 + e) p T = (v - r y) T                                                  no slip

G = int w e^(ic) = 2 sin(int w / 2) carries the tilt tau of the spin axis. The specific force of a lever arm
rho is (i w' - w²) rho, whose turned form is the derivative of i w e^(ic) rho: L is the difference of that
at the edges, so centripetal and tangential terms leave together. u is what a clipped gyro did not see, zero
otherwise; the centripetal force shows it as well (`centripetal_row`). The hub moves at R w, w the rate
about the axle, with or without camber. b_r is the constant yaw rate that gravity makes in a gyro that feels
it.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

from hubodo.earth import STANDARD_GRAVITY
from hubodo.fuse.wheel.preintegration import WINDOW, Window

# Of each wheel, in this order.
(
    ANGLE,
    SPIN_SCALE,
    SPIN_BIAS,
    BIAS_X,
    BIAS_Y,
    TILT_X,
    TILT_Y,
    ARM_X,
    ARM_Y,
    FORCE_X,
    FORCE_Y,
    FORCE_Z,
    CAMBER,
    YAW_SCALE,
    YAW_BIAS,
    RADIUS,
    LEAK_X,
    LEAK_Y,
    EXCESS,
) = range(19)
WHEEL_STATES = 19

# Of the vehicle, in front of the wheels.
X, Y, HEADING, SPEED, YAW_RATE, TRACK, CLOCK, SLOPE = range(8)
VEHICLE_STATES = 8

ROWS = 5
YAW, ROLL, FORWARD, SIDEWAYS, ROLLING = range(ROWS)


@dataclass(frozen=True, slots=True)
class WheelGeometry:
    """side: +1 left, -1 right. radius: m. contact: y of the contact in the body, m. clocked: +1 where the
    state CLOCK, in s, is the lateness of this node's time stamps, else 0."""

    side: float
    radius: float
    contact: float
    clocked: float = 0.0


_ENTRIES: tuple[tuple[int, tuple[int, ...], tuple[int, ...]], ...] = (
    (
        YAW,
        (YAW_RATE,),
        (ANGLE, SPIN_SCALE, SPIN_BIAS, EXCESS, BIAS_X, BIAS_Y, TILT_X, TILT_Y, CAMBER, YAW_SCALE, YAW_BIAS),
    ),
    (ROLL, (YAW_RATE,), (ANGLE, SPIN_SCALE, SPIN_BIAS, EXCESS, BIAS_X, BIAS_Y, TILT_X, TILT_Y, CAMBER)),
    (
        FORWARD,
        (YAW_RATE, SLOPE),
        (ANGLE, SPIN_SCALE, SPIN_BIAS, EXCESS, ARM_X, ARM_Y, FORCE_X, FORCE_Y, CAMBER),
    ),
    (SIDEWAYS, (YAW_RATE,), (SPIN_SCALE, SPIN_BIAS, EXCESS, FORCE_Z, CAMBER, LEAK_X, LEAK_Y, ARM_X, ARM_Y)),
    (ROLLING, (SPEED, YAW_RATE, TRACK, CLOCK), (SPIN_SCALE, SPIN_BIAS, EXCESS, CAMBER, RADIUS)),
)


def row_place(wheel: int, row: int, wheels: int) -> int:
    """Where a row of a wheel stands among those of all wheels: rolling comes last, after all that gives
    yaw."""
    return (ROWS - 1) * wheels + wheel if row == ROLLING else (ROWS - 1) * wheel + row


def jacobian_places(wheel: int, wheels: int) -> tuple[list[int], list[int]]:
    """Rows and columns, in the whole filter, of the numbers that `wheel_rows` gives for wheel number
    `wheel`."""
    rows, columns = [], []
    for row, shared, own in _ENTRIES:
        places = [*shared, *(VEHICLE_STATES + wheel * WHEEL_STATES + state for state in own)]
        rows += [row_place(wheel, row, wheels)] * len(places)
        columns += places
    return rows, columns


def wheel_rows(
    vehicle: list[float], wheel: list[float], window: Window, geometry: WheelGeometry
) -> tuple[list[float], list[float], float]:
    """Residuals (measured minus expected, 5), minus their derivatives, and the wheel rate p in rad/s.

    vehicle, wheel: the states named above. The derivatives stand in the order of `jacobian_places`.
    """
    _, _, _, speed, r, track, clock, slope = vehicle
    angle, k, b, bias_x, bias_y, tilt_x, tilt_y, arm_x, arm_y, force_x, force_y, *rest = wheel
    force_z, camber, yaw_scale, yaw_bias, radius_error, leak_along, leak_across, excess = rest
    side, radius, spin = geometry.side, geometry.radius, window.spin
    scale, stretch = 1.0 + yaw_scale, 1.0 + k
    sin, cos = math.sin(camber), math.cos(camber)
    t, half = WINDOW, 0.5 * WINDOW

    seen = (spin / t - b) / stretch
    about_axle = seen + excess
    p = about_axle - side * r * sin
    p_k, p_b, p_camber, p_r = -seen / stretch, -1.0 / stretch, -side * r * cos, -side * sin
    turn = cmath.exp(1j * (angle + p * half))

    carrier, tilt, lever = window.carrier * turn, window.swing * turn, window.lever * turn
    across = window.across * turn - complex(bias_x, bias_y) * carrier - complex(tilt_x, tilt_y) * tilt
    yaw = across.real - (scale * cos * r + yaw_bias) * t
    roll = across.imag

    force = window.force * turn - complex(force_x, force_y) * carrier - complex(arm_x, arm_y) * lever
    gain = window.rate_end - window.rate_start
    forward = force.imag - radius * gain - slope * t

    leak, sway = window.raw_force, 2.0 * spin / t * window.raw_across
    leak_x, leak_y, swing_x, swing_y = leak.real, leak.imag, sway.real, sway.imag
    lateral = cos * r * radius
    level = side * STANDARD_GRAVITY
    sideways = window.axial - leak_along * leak_x - leak_across * leak_y - arm_x * swing_x - arm_y * swing_y
    sideways -= (level * sin + lateral * about_axle + force_z) * t

    size = radius * (1.0 + radius_error)
    contact = geometry.contact * (1.0 + track)
    late = geometry.clocked * radius * gain
    rolling = (size * p - speed + r * contact) * t + clock * late

    a_real, a_imag = -roll * half, across.real * half
    f_imag = force.real * half
    derivatives = [
        # yaw
        scale * cos * t - a_real * p_r,
        roll,
        -a_real * p_k,
        -a_real * p_b,
        -a_real,
        carrier.real,
        -carrier.imag,
        tilt.real,
        -tilt.imag,
        -a_real * p_camber - scale * sin * r * t,
        cos * r * t,
        t,
        # roll
        -a_imag * p_r,
        -across.real,
        -a_imag * p_k,
        -a_imag * p_b,
        -a_imag,
        carrier.imag,
        carrier.real,
        tilt.imag,
        tilt.real,
        -a_imag * p_camber,
        # forward
        -f_imag * p_r,
        t,
        -force.real,
        -f_imag * p_k,
        -f_imag * p_b,
        -f_imag,
        lever.imag,
        lever.real,
        carrier.imag,
        carrier.real,
        -f_imag * p_camber,
        # sideways
        cos * radius * about_axle * t,
        lateral * p_k * t,
        lateral * p_b * t,
        lateral * t,
        t,
        (level * cos - sin * r * radius * about_axle) * t,
        leak_x,
        leak_y,
        swing_x,
        swing_y,
        # rolling
        t,
        -(size * p_r + contact) * t,
        -r * geometry.contact * t,
        -late,
        -size * p_k * t,
        -size * p_b * t,
        -size * t,
        -size * p_camber * t,
        -radius * p * t,
    ]
    return [yaw, roll, forward, sideways, rolling], derivatives, p


def centripetal_row(
    vehicle: list[float], wheel: list[float], window: Window, geometry: WheelGeometry
) -> tuple[float, dict[int, float]] | None:
    """Residual and minus its derivatives by wheel state of the force towards the axle, for a clipped gyro.

    Along the lever arm, gravity taken out with the wheel angle: int f . rho/|rho| = (g along it + a - w²
    |rho|) T. None where the arm is too short to feel the spin.
    """
    arm = complex(wheel[ARM_X], wheel[ARM_Y])
    length = abs(arm)
    if length < 2e-3:
        return None
    t = WINDOW
    along = (arm / length).conjugate()
    seen = (window.spin / t - wheel[SPIN_BIAS]) / (1.0 + wheel[SPIN_SCALE])
    rate = seen + wheel[EXCESS]
    p = rate - geometry.side * vehicle[YAW_RATE] * math.sin(wheel[CAMBER])
    turn = cmath.exp(-1j * (wheel[ANGLE] + 0.5 * p * t))
    gravity = STANDARD_GRAVITY * math.cos(wheel[CAMBER]) * turn * window.carrier.conjugate()
    steady = gravity + complex(wheel[FORCE_X], wheel[FORCE_Y]) * t
    felt = window.raw_force - steady
    residual = (felt * along).real + rate * rate * length * t
    # The direction of the arm counts in what is left across it.
    across = (felt * along).imag / length
    unit = arm / length
    spin = 2.0 * rate * length * t
    by_angle = (-1j * gravity * along).real
    return residual, {
        ANGLE: by_angle,
        EXCESS: 0.5 * t * by_angle - spin,
        ARM_X: -rate * rate * t * unit.real + across * unit.imag,
        ARM_Y: -rate * rate * t * unit.imag - across * unit.real,
        FORCE_X: along.real * t,
        FORCE_Y: -along.imag * t,
    }
