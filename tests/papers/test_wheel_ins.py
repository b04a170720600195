"""The published method Wheel-INS follows an ideal drive; the comparison with it is no straw man."""

from __future__ import annotations

import numpy as np
import pytest

from generators import wheel_drives
from papers.filters.wheel_ins import WheelIns

ARM = (0.03, -0.02)
SPEED = 1.2
AVERAGED_S = 0.1


@pytest.mark.parametrize("facing", ["left", "right"])
def test_an_ideal_drive_ends_where_it_should(facing):
    """The measured speed is a mean of 0.1 s, so it lags while the speed changes: here at start and stop."""
    plan = wheel_drives.legs([(4.0, 0.0, 0.0), (10.0, SPEED, 0.25), (10.0, SPEED, -0.1), (3.0, 0.0, 0.0)])
    rng = np.random.default_rng(5)
    drive = wheel_drives.drive(plan, rng, errors=wheel_drives.PERFECT, facing={"left": facing}, arm=ARM)
    node = drive.nodes["left"]
    centre = (-node.truth["arm_x"], -node.truth["arm_y"], 0.0)
    method = WheelIns(drive.radius, axle_sign=1 if facing == "left" else -1, arm=centre)
    track = method.run(node.t, node.gyro, node.accel, 3.0)
    heading = track.heading - track.heading[0]
    wheel = (track.x + 1j * track.y) * np.exp(-1j * track.heading[0])
    middle = wheel - 0.5j * drive.track * np.exp(1j * heading)
    truth = np.interp(track.t, drive.t, drive.x) + 1j * np.interp(track.t, drive.t, drive.y)
    assert np.abs(middle - middle[0] - truth).max() < AVERAGED_S * SPEED
    assert np.abs(heading - np.interp(track.t, drive.t, drive.heading)).max() < np.radians(0.3)
