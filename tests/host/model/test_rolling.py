"""Rolling of an eccentric wheel: spin is the derivative of the angle and satisfies the equation."""

import numpy as np
import pytest

from hubodo.effects.sensor_chain import Geometry
from hubodo.model.inputs import BodyMotion
from hubodo.model.rolling import wheel_rotation

RADIUS, TRACK = 0.3, 0.6
T = np.linspace(0.0, 6.0, 6001)


def swaying():
    """v = 1.2 + 0.4 sin 0.9 t, r = 0.3 cos 0.7 t, with their integrals and derivatives."""
    v, r = 0.9 * T, 0.7 * T
    return BodyMotion(
        t=T,
        speed=1.2 + 0.4 * np.sin(v),
        acceleration=0.36 * np.cos(v),
        jerk=-0.324 * np.sin(v),
        distance=1.2 * T + 0.4 / 0.9 * (1.0 - np.cos(v)),
        yaw_rate=0.3 * np.cos(r),
        yaw_acceleration=-0.21 * np.sin(r),
        yaw_jerk=-0.147 * np.cos(r),
        heading=0.3 / 0.7 * np.sin(r),
        temperature=np.full(len(T), 25.0),
        supply=np.full(len(T), 3.7),
    )


@pytest.mark.parametrize("phase", [0.0, 0.5 * np.pi, 2.2])
@pytest.mark.parametrize(("side", "sign"), [("left", 1.0), ("right", -1.0)])
def test_a_wheel_off_its_centre_turns_slower_where_its_radius_is_larger(side, sign, phase):
    """theta' = v_w / (R (1 + A cos(theta - phase))); derivatives of the angle by central differences."""
    amplitude, body = 0.03, swaying()
    centre = (amplitude * np.cos(phase), amplitude * np.sin(phase))
    if phase == 0.5 * np.pi:
        centre = (0.0, amplitude)
    rolling = wheel_rotation(body, Geometry(side, RADIUS, TRACK, eccentricity=centre), initial_angle=0.4)
    speed = body.speed - body.yaw_rate * sign * TRACK / 2
    expected = speed / (RADIUS * (1.0 + amplitude * np.cos(rolling.angle - phase)))
    assert rolling.angle[0] == pytest.approx(0.4)
    assert rolling.spin == pytest.approx(expected, rel=1e-9)
    assert np.gradient(rolling.angle, T)[1:-1] == pytest.approx(rolling.spin[1:-1], abs=1e-5)
    assert np.gradient(rolling.spin, T)[1:-1] == pytest.approx(rolling.spin_acceleration[1:-1], abs=1e-4)
