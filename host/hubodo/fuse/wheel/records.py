"""What a step of the wheel filter takes in, and what it gives out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel.entries import HEADING, SPEED, YAW_RATE, X, Y
from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.window import Window

POSE_ENTRIES = (X, Y, HEADING, SPEED, YAW_RATE)


class StepInput(NamedTuple):
    """What happened at once: the windows of all wheels of one number, in the order of the nodes.

    Or no windows: nothing was heard of any wheel in `spans` windows up to this number. listen: look for the
    angle of wheels that were not heard. speeds: m/s of the left and the right wheel's surface, where another
    odometer tells them.
    """

    windows: tuple[Window, ...]
    number: int
    realign: bool
    spans: int = 1
    surface_speeds: tuple[float, float] | None = None


class Pose(NamedTuple):
    """End of a step.

    t: s; x, y: m; heading: rad, unwrapped; speed: m/s and yaw_rate: rad/s, means over the window. covariance:
    (5, 5) of x, y, heading, speed, yaw_rate. still: whether the vehicle stood still. nis, degrees: squared
    innovations of the step over their variance, and how many there were. carrying: whether no wheel told the
    speed, but the accelerometers.
    """

    t: float
    x: float
    y: float
    heading: float
    speed: float
    yaw_rate: float
    covariance: Array
    motion_state: MotionState
    nis: float
    dof: int
    inertial_speed: bool = False


class StepRecord(NamedTuple):
    """Both sides of a step's measurements: states and covariance before and after.

    renewed: the states that the step began anew, without memory. carried: the place of the one that it made
    from others before anything else, and the derivatives (n,) of it by them, if any. passed: (n, n),
    derivatives of the states before the measurements by those at the end of the step before, None where no
    time lies between. shortened: (2, 2) m² of x and y beyond what p has.
    """

    prior_x: list[float]
    prior_p: Array
    reset_states: list[int]
    x: list[float]
    p: Array
    speed_row: tuple[int, Array] | None = None
    outage_transition: Array | None = None
    heading_inflation: Array = np.zeros((2, 2))


class Innovation(NamedTuple):
    """What a position says that is new.

    z: (2,) m, the position less what was expected; s: (2, 2) m², its covariance; ph: (n, 2), its covariance
    with the states; nis: z in units of s, squared.
    """

    z: Array
    s: Array
    ph: Array
    nis: float

    @property
    def cost(self) -> float:
        """Minus twice the logarithm of its likelihood, but for a constant."""
        return self.nis + float(np.linalg.slogdet(self.s)[1])
