"""Confusable effects are confusable, until the manoeuvre that distinguishes them.

The measure is the angle between the changes of the channels.
"""

from dataclasses import dataclass

import numpy as np
import pytest

from hubodo.effects import BY_NAME, EFFECTS
from hubodo.model.forward import NodeInitialState, NodeModel
from hubodo.model.inputs import MotionInputs, Trace
from hubodo.smoothing_spline import fit_interpolating_spline
from hubodo.vehicle import NodeMount

NOISE = np.repeat([0.004, 0.05], 3)[:, None]
"""rad/s and m/s², 1σ of a sample: weights of the channels."""

CHANNELS = {"all": slice(0, 6), "gyro": slice(0, 3), "gz": slice(2, 3), "accel": slice(3, 6)}
MAX_CONFUSABLE_SINE, MIN_DISTINCT_SINE = 0.1, 0.1
"""Largest sine between confusable effects, and smallest one after the manoeuvre, which also triples it."""


@dataclass(frozen=True)
class Drive:
    """A drive: speed, yaw rate and temperature at t.

    grades: sign of the grade on each leg of the same drive. powered: s of power before the start of the log.
    body: the node is on the body, not on a wheel. beside: further effects of unknown size.
    """

    speed: object = lambda t: 1.5
    yaw: object = lambda t: 0.0
    temperature: object = lambda t: 25.0
    grades: tuple[float, ...] = (1.0,)
    powered: float = 0.0
    body: bool = False
    beside: tuple[str, ...] = ()

    def forward(self):
        t = np.arange(0.0, 40.005, 0.01)
        speed, yaw, warm = (f(t) + 0.0 * t for f in (self.speed, self.yaw, self.temperature))
        inputs = MotionInputs(
            fit_interpolating_spline(t, speed), fit_interpolating_spline(t, yaw), Trace(t, warm)
        )
        mount = NodeMount() if self.body else NodeMount("left", "left")
        return NodeModel(inputs, np.arange(0.5, 39.5, 0.02), mount, 0.31, 0.92, -self.powered)


def halves(t):
    """Return a speed that rises from 0.7 to 2.7 m/s in the middle."""
    return 0.7 + 2.0 / (1.0 + np.exp(20.0 - t))


def brisk(t):
    return 1.6 + np.sin(1.3 * t) + 0.3 * np.sin(3.1 * t)


def to_both_sides(t):
    return 0.8 * np.sin(0.4 * t) + 0.4 * np.sin(1.1 * t)


def up_and_down(t):
    return 25.0 + 6.0 * np.sin(2.0 * np.pi * t / 40.0)


def settling(t):
    return 25.0 + 8.0 * (1.0 - np.exp(-t / 25.0))


STRAIGHT, STANDING = Drive(), Drive(lambda t: 0.0)
CIRCLE = Drive(yaw=lambda t: 0.5)
TURNS = Drive(yaw=to_both_sides)
TWO_SPEEDS = Drive(halves)
EVEN = Drive(lambda t: 1.5 + 0.1 * np.sin(0.5 * t))
BRISK = Drive(brisk)
SLOW = Drive(lambda t: 0.5)
LIVELY = Drive(brisk, to_both_sides)
ROAD = Drive(yaw=lambda t: 0.5, grades=(1.0,))
BACK = Drive(yaw=lambda t: 0.5, grades=(1.0, -1.0))
BODY, BODY_BACK = Drive(body=True), Drive(body=True, grades=(1.0, -1.0))

# Pair: drive on which the effects are confusable, in which channels, and the manoeuvre that separates them.
PAIRS = {
    "track_width wheel_camber": (TURNS, "gz", TURNS),
    "track_width wheel_radius": (CIRCLE, "all", TURNS),
    "track_width gyro_scale_factor": (CIRCLE, "gz", TURNS),
    "road_grade gyro_nonorthogonality": (ROAD, "all", BACK),
    "road_grade accel_nonorthogonality": (ROAD, "all", BACK),
    "road_grade accel_bias": (BODY, "all", BODY_BACK),
    "road_grade node_misalignment": (BODY, "all", BODY_BACK),
    "wheel_radius gyro_scale_factor": (STRAIGHT, "gyro", TWO_SPEEDS),
    "wheel_radius tyre_growth": (STRAIGHT, "all", TWO_SPEEDS),
    "wheel_radius clock_skew": (STRAIGHT, "accel", BRISK),
    "tyre_growth gyro_cubic": (STRAIGHT, "gyro", TWO_SPEEDS),
    "wheel_slip time_offset": (TWO_SPEEDS, "all", LIVELY),
    "wheel_camber accel_bias": (STRAIGHT, "all", LIVELY),
    "lever_arm accel_bias": (STRAIGHT, "all", TWO_SPEEDS),
    "lever_arm accel_scale_factor": (CIRCLE, "all", TWO_SPEEDS),
    "node_misalignment gyro_nonorthogonality": (STRAIGHT, "gyro", SLOW),
    "node_misalignment accel_nonorthogonality": (STRAIGHT, "accel", TWO_SPEEDS),
    "node_misalignment wheel_camber": (STANDING, "all", TURNS),
    "gyro_lag time_offset": (BRISK, "gyro", BRISK),
    "gyro_lag wheel_slip": (EVEN, "gz", LIVELY),
    "gyro_scale_factor tyre_growth": (STRAIGHT, "gyro", TWO_SPEEDS),
    "gyro_scale_factor gyro_cubic": (STRAIGHT, "all", TWO_SPEEDS),
    "gyro_scale_factor clock_skew": (
        Drive(beside=("wheel_radius",)),
        "all",
        Drive(brisk, beside=("wheel_radius",)),
    ),
    "gyro_warmup gyro_temperature": (
        Drive(temperature=settling),
        "all",
        Drive(temperature=up_and_down),
    ),
    "gyro_warmup gyro_bias": (Drive(powered=300.0), "all", STRAIGHT),
    "gyro_temperature gyro_bias": (
        Drive(temperature=lambda t: 31.0),
        "all",
        Drive(temperature=up_and_down),
    ),
    "gyro_g_sensitivity wheel_eccentricity": (STRAIGHT, "gyro", TWO_SPEEDS),
    "gyro_g_sensitivity gyro_bias": (CIRCLE, "all", TURNS),
    "accel_scale_factor accel_nonorthogonality": (STANDING, "all", LIVELY),
    "clock_skew time_offset": (TWO_SPEEDS, "gyro", LIVELY),
}


def changes(drive, name):
    """Return the change per coordinate of an effect, (6, samples) in sigma, for all legs.

    Also return the change by a rotation of the wheel at the start.
    """
    forward, kind = drive.forward(), BY_NAME[name]
    at = min(kind.initial_guesses(), key=lambda seed: abs(seed.values().get("time_constant", 25.0) - 25.0))

    def reads(effects, start=0.3):
        columns_matrix = forward.mean_reading(effects, NodeInitialState(start))
        return np.concatenate([columns_matrix.gyro, columns_matrix.accel]) / NOISE

    columns = []
    for k, scale in enumerate(kind.coordinate_scales()):
        step = np.zeros(len(at.coordinates()))
        step[k] = 1e-3 * scale
        ahead, behind = (reads([at.with_coordinates(at.coordinates() + sign * step)]) for sign in (1, -1))
        columns.append((ahead - behind) / 2e-3)
    signs = drive.grades if name == "road_grade" else (1.0,) * len(drive.grades)
    turned = (reads([], 0.3 + 1e-4) - reads([], 0.3 - 1e-4)) / 2e-4
    return [np.concatenate([s * c for s in signs], axis=1) for c in columns], [
        np.concatenate([turned] * len(signs), axis=1)
    ]


def spanned(columns, channels, without=None):
    """Return orthonormal directions of the visible columns, orthogonal to `without`."""
    rows = [column[CHANNELS[channels]].ravel() for column in columns]
    visible = [row / np.linalg.norm(row) for row in rows if np.linalg.norm(row) > 0.3]
    if not visible:
        return np.empty((rows[0].size, 0))
    columns_matrix = np.array(visible).T
    if without is not None:
        columns_matrix = columns_matrix - without @ (without.T @ columns_matrix)
    u, sizes, _ = np.linalg.svd(columns_matrix, full_matrices=False)
    return u[:, sizes > 1e-3]


def unexplained_sine(one, other, drive, channels="all"):
    """Return the sine of the smallest angle between the changes of two effects; nan if one changes nothing.

    The initial wheel angle and the sizes of the effects in `beside` are unknown.
    """
    mine, start = changes(drive, one)
    beside = [column for name in drive.beside for column in changes(drive, name)[0]]
    known = spanned([*start, *beside], channels)
    a, b = spanned(mine, channels, known), spanned(changes(drive, other)[0], channels, known)
    if not a.size or not b.size:
        return float("nan")
    return float(np.sqrt(max(0.0, 1.0 - np.linalg.svd(a.T @ b, compute_uv=False).max() ** 2)))


def test_every_confusable_pair_that_is_visible_in_the_mean_is_tested_here():
    declared = {
        f"{kind.name} {other}"
        for kind in EFFECTS
        for other in kind.confusable_with
        if kind.visible_in == "mean" and BY_NAME[other].visible_in == "mean"
    }
    assert declared == set(PAIRS)


@pytest.mark.parametrize("pair", PAIRS)
def test_a_confusable_pair_is_distinguished_by_its_manoeuvre(pair):
    one, other = pair.split()
    quiet, channels, manoeuvre = PAIRS[pair]
    confusable_sine = unexplained_sine(one, other, quiet, channels)
    distinct_sine = unexplained_sine(one, other, manoeuvre)
    assert confusable_sine < MAX_CONFUSABLE_SINE, f"alike {confusable_sine:.3f}, apart {distinct_sine:.3f}"
    assert distinct_sine > max(MIN_DISTINCT_SINE, 3.0 * confusable_sine), (
        f"alike {confusable_sine:.3f}, apart {distinct_sine:.3f}"
    )
