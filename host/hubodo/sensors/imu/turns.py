"""The gyro triad from the turns between rests: what the gyros add up to must carry gravity from pose to pose.

For gyros too noisy to see Earth rate this replaces it as the reference, and it sees all six misalignments
one by one, in the frame of the accelerometer triad, because a turn has a direction and not only a size. With
C the attitude (node to world), dC/dt = C [omega x] and gravity g fixed in space, the vector seen in the node
goes over into f_end = R' f_start with R the product of exp([omega dt x]) over the turn.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.errors import CalibrationError
from hubodo.sensors.imu.pose_set import ANY_TRIAD, SEEN
from hubodo.sensors.imu.quaternions import (
    cross,
    matrices_back,
    product,
    products_after,
    quaternions,
    rotate_back,
)
from hubodo.sensors.imu.rests import Rests

MIN_TURNS = 3
MIN_ANGLE = 0.17
"""rad, 10 degrees; a smaller turn says less about the gyros than about the rests."""
OUTLIER = 6.0
"""Times the robust scatter of the errors; beyond it a turn was clipped, knocked or had a gap."""
_PAD_S = 0.1
_NEAR = 1e-6
"""Change of the parameters through which the derivatives stay what they are."""
_NAMES = ("scale x", "xz", "xy", "yz", "scale y", "yx", "zy", "zx", "scale z")
_UNITS = {57.29578: "degrees per second", 57295.78: "mdps", 1000.0: "mrad/s"}


@dataclass(frozen=True)
class TurnCalibration:
    """Gyro triad from T turns.

    matrix: (3, 3) M in the frame of the accelerometer triad. bias_change: (3,) rad/s, correction of the bias
    that the turns ask for. covariance: (12, 12) of the bias and of M row by row. response: (12, T, 3) what
    they answer to a change of each miss, the vector (3,) between gravity as carried and as seen. seen: (9,)
    which elements of M the turns show; the others are as the factory promises. used: (T,) number of each
    turn, from 0. angle: (T,) rad, how far gravity turned. error: (T,) rad, between gravity as the gyros
    carried it and as the accelerometers saw it, after calibration; before: the same with the bias alone taken
    off. dropped: one line for each turn that was left out.
    """

    matrix: Array
    bias_change: Array
    covariance: Array
    response: Array
    seen: NDArray[np.bool_]
    used: NDArray[np.int64]
    angle: Array
    error: Array
    before: Array
    dropped: tuple[str, ...] = ()

    @property
    def complaint(self) -> str:
        """What the turns do not show and what would help, or ""."""
        unseen = [name for name, seen in zip(_NAMES, self.seen, strict=True) if not seen]
        if not unseen:
            return ""
        axes = sorted({axis for name in unseen for axis in name.replace("scale ", "") if axis in "xyz"})
        return (
            f"the turns between rests cannot show {', '.join(unseen)} of the gyro triad; add turns of 90 to "
            f"180 degrees about {' and '.join(axes)} with that axis level"
        )


@dataclass(frozen=True)
class Turns:
    """Gyro samples of T turns, padded to one length with steps of no duration.

    rate: (T, L, 3) rad/s, bias taken off, mean over each step. change: (T, L, 3) rad/s within the step. dt:
    (T, L) s. start, end: (T, 3) unit vectors of gravity in the node. number: (T,) of the turn in the record.
    clipped: (T,) whether a channel stood at its extreme.
    """

    rate: Array
    change: Array
    dt: Array
    start: Array
    end: Array
    number: NDArray[np.int64]
    clipped: NDArray[np.bool_]

    def select(self, which: NDArray[np.bool_] | NDArray[np.int64]) -> Turns:
        """Those turns alone."""
        return Turns(
            self.rate[which],
            self.change[which],
            self.dt[which],
            self.start[which],
            self.end[which],
            self.number[which],
            self.clipped[which],
        )

    @property
    def angle(self) -> Array:
        """(T,) rad by which gravity turned in the node."""
        return _between(self.start, self.end)


def collect_turns(t: Array, gyro: Array, bias: Array, rests: Rests, gravity: Array) -> Turns:
    """The stretches between consecutive rests.

    gyro: (N, 3) raw. bias: (3,), or (N, 3) where it follows the specific force. gravity: (R, 3) calibrated
    accelerometer means of the rests. Only the motion itself is taken, so that a bias left over has little
    time.
    """
    unit = gravity / np.linalg.norm(gravity, axis=1)[:, None]
    step = float(np.median(np.diff(t)))
    pad = round(_PAD_S / step)
    extreme = np.abs(gyro).max(axis=0)
    spans = [(int(rests.end[k]) - 1 - pad, int(rests.start[k + 1]) + 1 + pad) for k in range(len(rests) - 1)]
    spans = [(max(0, i), min(len(t), j)) for i, j in spans]
    length = max((j - i - 1 for i, j in spans), default=1)
    rate, change = np.zeros((2, len(spans), length, 3))
    dt = np.zeros((len(spans), length))
    clipped = np.zeros(len(spans), bool)
    for k, (i, j) in enumerate(spans):
        w = gyro[i:j] - (bias if bias.ndim == 1 else bias[i:j])
        rate[k, : j - i - 1] = (w[1:] + w[:-1]) / 2
        change[k, : j - i - 1] = np.diff(w, axis=0)
        dt[k, : j - i - 1] = np.diff(t[i:j])
        clipped[k] = bool(((np.abs(gyro[i:j]) >= extreme * 0.9999).sum(axis=0) >= 4).any())
    return Turns(rate, change, dt, unit[:-1], unit[1:], np.arange(len(spans)), clipped)


def carried(turns: Turns, matrix: Array, bias_change: Array | float = 0.0) -> Array:
    """(T, 3) where the gyros say gravity points at the end of each turn."""
    return rotate_back(product(quaternions(_angles(turns, matrix, bias_change))).T, turns.start)


def carried_slopes(turns: Turns, matrix: Array, bias_change: Array) -> tuple[Array, Array]:
    """`carried`, and (T, 3, 12) its derivatives by `matrix`, row by row, and `bias_change`.

    A step whose rotation vector a changes by da turns gravity at the end, u, by u x f with
    f = S' (1 - [a x] / 2 + [a x]² / 6) da, S the steps after it: the right Jacobian of SO(3) (Sola, Deray,
    Atchuthan 2018) to the second order of a. What the coning term changes is left out, 1e-4 of the rest.
    """
    angle = _angles(turns, matrix, bias_change)
    whole, after = products_after(quaternions(angle))
    end = rotate_back(whole.T, turns.start)
    x, y, z = 0.5 * np.moveaxis(angle, -1, 0)
    rest = 1.0 - (x * x + y * y + z * z) / 1.5
    first = np.array([[rest, z, -y], [-z, rest, x], [y, -x, rest]])
    # [a x]² = a a' - a²
    felt = np.moveaxis(first, (0, 1), (-2, -1)) + angle[..., :, None] * angle[..., None, :] / 6.0
    inverse = np.linalg.inv(matrix)
    felt = matrices_back(after) @ felt
    by = np.concatenate([(turns.rate - bias_change) @ inverse.T, np.ones((*turns.dt.shape, 1))], axis=-1)
    by = by * turns.dt[..., None]
    # (T, 3, 4, 3): f by what each column of the inverse does to each axis of the rate, and to one.
    summed = (felt.reshape(*by.shape[:2], 9).transpose(0, 2, 1) @ by).reshape(-1, 3, 3, 4)
    summed = -summed.transpose(0, 1, 3, 2) @ inverse
    turned = np.concatenate(
        [summed[:, :, :3].transpose(0, 1, 3, 2).reshape(-1, 3, 9), summed[:, :, 3]], axis=-1
    )
    return end, np.cross(end[:, :, None], turned, axis=1)


def _angles(turns: Turns, matrix: Array, bias_change: Array | float) -> Array:
    """(T, L, 3) rad by which the node turns in each step."""
    inverse = np.linalg.inv(matrix)
    rate = (turns.rate - bias_change) @ inverse.T
    dt = turns.dt[..., None]
    # Second term: coning of a rate that changes evenly within the step, w0 x w1 dt²/12.
    return np.asarray(rate * dt + cross(rate, turns.change @ inverse.T) * dt**2 / 12)


def turn_errors(turns: Turns, matrix: Array, bias_change: Array | float = 0.0) -> Array:
    """(T,) rad between gravity as carried and as seen."""
    return _between(carried(turns, matrix, bias_change), turns.end)


def calibrate_by_turns(turns: Turns, bias_sigma: Array) -> TurnCalibration:
    """M of the gyros, and a correction of their bias within its sigma (3,) rad/s from the rests.

    Raises CalibrationError when there are too few turns, when they show no element of M, or when the gyros
    are in another unit.
    """
    large = turns.angle > MIN_ANGLE
    dropped = [f"turn {k + 1}: the gyro was clipped" for k in turns.number[turns.clipped & large]]
    usable = turns.select(large & ~turns.clipped)
    if len(usable.dt) < MIN_TURNS:
        raise CalibrationError(
            f"only {len(usable.dt)} turns of more than 10 degrees between rests can be used, {MIN_TURNS} "
            f"are needed "
            f"({len(dropped)} clipped); turn the node about each of its axes, both ways, with rests between"
        )
    _check_unit(usable)
    p, covariance, response = _fit(usable, bias_sigma)
    error = turn_errors(usable, *_split(p))
    # Rayleigh: the median of the error is 1.18 times the deviation of each of its two components.
    bad = error > OUTLIER * max(float(np.median(error)) / 1.1774, 1e-5)
    if bad.any() and np.count_nonzero(~bad) >= MIN_TURNS:
        dropped += [
            f"turn {k + 1}: off by {np.degrees(e):.2f} degrees"
            for k, e in zip(usable.number[bad], error[bad], strict=True)
        ]
        usable = usable.select(~bad)
        p, covariance, response = _fit(usable, bias_sigma)
    matrix, change = _split(p)
    seen = np.sqrt(np.diag(covariance)[:9]) <= SEEN
    order = [9, 10, 11, *range(9)]
    found = TurnCalibration(
        matrix,
        change,
        covariance[np.ix_(order, order)],
        response[order].reshape(12, -1, 3),
        seen,
        usable.number,
        usable.angle,
        turn_errors(usable, matrix, change),
        turn_errors(usable, np.eye(3)),
        tuple(dropped),
    )
    if not seen.any():
        raise CalibrationError(found.complaint)
    return found


def _split(p: Array) -> tuple[Array, Array]:
    return np.eye(3) + p[:9].reshape(3, 3), p[9:]


def _fit(turns: Turns, bias_sigma: Array) -> tuple[Array, Array, Array]:
    """Gauss-Newton on the miss of each turn, in units of the scatter, beside what is known without turns.

    Returns the parameters (12,), their covariance and their response (12, 3 T) to the misses.
    """
    p, scatter = np.zeros(12), 0.01
    before = np.concatenate([np.full(9, ANY_TRIAD.rest), bias_sigma]) ** -2
    end, slopes = carried_slopes(turns, *_split(p))
    miss = end - turns.end
    for _ in range(12):
        jacobian = slopes.reshape(-1, 12) / scatter
        information = jacobian.T @ jacobian + np.diag(before)
        response = -np.linalg.solve(information, jacobian.T) / scatter
        step = response @ miss.ravel() - np.linalg.solve(information, before * p)
        p = p + step
        if np.abs(step).max() > _NEAR:
            end, slopes = carried_slopes(turns, *_split(p))
        else:
            end = carried(turns, *_split(p))
        miss = end - turns.end
        # A miss has two components, gravity being of unit length.
        used = -float(np.trace(response @ jacobian)) * scatter
        freedom = max(1.0, 2 * len(miss) - used)
        new = max(float(np.sqrt((miss**2).sum() / freedom)), 1e-7)
        settled = np.abs(step[:9]).max() < 1e-8 and abs(new / scatter - 1) < 1e-3
        scatter = new
        if settled:
            # The scatter is known from few misses: the variance of Student's t.
            widened = np.asarray(np.linalg.inv(information) * (freedom / max(freedom - 2.0, 0.5)))
            return p, widened, np.asarray(response)
    raise CalibrationError(
        "the gyro calibration by turns does not settle; check that the gyro is in rad/s and that its axes "
        "are those of the accelerometer"
    )


def _check_unit(turns: Turns) -> None:
    """Gravity must turn by about as much as the gyros say; a factor of 57 is a unit and no scale error."""
    swept = np.linalg.norm(turns.rate * turns.dt[..., None], axis=2).sum(axis=1)
    ratio = float(np.median(swept / turns.angle))
    if ratio > 20:
        unit = min(_UNITS, key=lambda factor: abs(np.log(ratio / factor)))
        raise CalibrationError(
            f"the gyros add up to {ratio:.0f} times the turns that gravity shows, as if they were in "
            f"{_UNITS[unit]}; "
            "convert the record to rad/s"
        )
    if ratio < 0.5:
        raise CalibrationError(
            f"the gyros add up to {ratio:.2g} of the turns that gravity shows; check their unit (rad/s) and "
            f"range"
        )


def _between(a: Array, b: Array) -> Array:
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1)))
