"""Checks of two wheels against each other: outlier rows, wrong mounting, steered wheels, track width."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel.thresholds import GATE_SIGMA, MANOEUVRE_WINDOWS
from hubodo.fuse.wheel.window import WINDOW_S, WINDOWS_PER_SECOND

BOTH_WHEELS = 0.0
"""Verdict of `MountingCheck`: both wheels are distrusted."""

_MIN_CHECK_SPEED = 0.1
"""m/s, a tenth of walking pace; slower wheels say nothing about their mounting. Estimated."""

_MAX_CHECK_WINDOWS = 3000
"""Windows after which the mounting counts as confirmed, 5 min. Estimated."""

AXLE_YAW_RMS, _GYRO_YAW_SHARE, _SPEED_YAW_SHARE = 0.03, 0.1, 0.2
"""Yaw-rate difference on one axle: rms in rad/s, and as a share of the yaw rate, of two gyros and of the
wheels' speeds against the gyros.

On real drives nodes on one axle differ by 0.005 rad/s (a car) and 0.03 at 0.6 rad/s (a wheelchair). Tape
measures are off by a tenth at most. Estimated.
"""

_MIN_STEERING_SHARE, _MIN_TURNED_ANGLE = 0.5, 3.0
"""Share of the squared difference by which one wheel must turn more than the other to be named as steered;
rad turned before speeds are judged.

A steered wheel turns more than the vehicle in the long run, because its own steering is not correlated with
the vehicle's turning. Estimated.
"""

_MAX_SIZE_RATIO = 0.05
"""Half of the relative difference of the two wheels' rolling radii up to which they belong to one axle.
Tapes and uncalibrated gyros differ by a few hundredths; wheels of two axles differ by their steering.
Estimated.
"""

_MAX_WIDTH_RATIO = 2.0
"""Ratio of shown and declared track width up to which it is mentioned: beyond, another fault is likely."""

_CAREFUL_TAPE_SIGMA, _MAX_DRIVE_SIGMA = 0.005, 0.01
"""Relative 1 sigma of a carefully measured track width (between the tyre centres), and the 1 sigma that a
drive must reach before that hypothesis is tested: half-circle turns do. Estimated.
"""


def track_width_test(error: float, variance: float, prior: float) -> float | None:
    """Return the variance of a pseudo-measurement "track width error = 0"; None: not (yet) accepted.

    Likelihood ratio of a carefully measured track, 1 sigma `_CAREFUL_TAPE_SIGMA`, against 1 sigma `prior`.
    The careful hypothesis must be more likely by e^(1/2): a wrong acceptance distorts every turn, a missed
    one costs little. error, variance: relative track width error as estimated now, with the wide prior
    included. Returns inf if rejected for good.
    """
    drive_variance = 1.0 / (1.0 / variance - 1.0 / prior**2) if variance < prior**2 else math.inf
    if drive_variance > _MAX_DRIVE_SIGMA**2:
        return None
    drive_error = error * drive_variance / variance
    careful_variance, prior_variance = drive_variance + _CAREFUL_TAPE_SIGMA**2, drive_variance + prior**2
    if (
        drive_error * drive_error * (1.0 / careful_variance - 1.0 / prior_variance)
        > math.log(prior_variance / careful_variance) - 0.5
    ):
        return math.inf
    return _CAREFUL_TAPE_SIGMA**2


def inflate_outlier_variances(
    whitened: Array,
    sigma: Array,
    residuals: Array,
    variances: Array,
    compared: Sequence[tuple[int, int]] | None,
) -> tuple[Array, int | None]:
    """Return variances under which no innovation exceeds 3 sigma, and the index of a slipping wheel, if any.

    whitened: innovations given the rows before them, in units of `sigma`; residuals: unwhitened. compared:
    rows of yaw and rolling of two wheels if all rows are present. If two yaw rates disagree, both lose
    weight. If two wheels roll apart, the one farther from the predicted speed is the slipping one.
    """
    is_outlier = np.abs(whitened) > GATE_SIGMA
    if not is_outlier.any():
        return variances, None
    extra = np.where(is_outlier, (whitened * whitened / GATE_SIGMA**2 - 1.0) * sigma * sigma, 0.0)
    outlier_wheel = None
    if compared is not None:
        (first_yaw, first), (second_yaw, second) = compared
        extra[first_yaw] = max(extra[first_yaw], extra[second_yaw])
        if is_outlier[second]:
            outlier_wheel = 0 if abs(residuals[first]) > abs(residuals[second]) else 1
            outlier_row = compared[outlier_wheel][1]
            extra[second] = 0.0
            extra[outlier_row] += residuals[outlier_row] ** 2
    return variances + extra, outlier_wheel


@dataclass
class MountingCheck:
    """Test of which mounting of two nodes explains the yaw rate of their gyros.

    The gyros across the axle measure the same yaw rate whichever way a node faces; the wheels' speeds change
    sign with the facing and are exchanged with the side. A node on a steered wheel also measures the
    steering rate.

    Attributes
    ----------
    track_width : m.
    yaw_residual_squares : (rad/s)², sums for the mounting as declared, left node reversed, right node
        reversed, and both reversed or sides exchanged.
    wheel_distances : m, of the left and the right wheel.
    yaw_rate_squares : (rad/s)² sums of the left and right gyro, and of their difference.
    size_regression : sums for the size ratio: squares of twice the speed over the track, and its product
    with the residual.
    axle_misfit : (rad/s)², excess of the residual over the tolerance.
    track_regression : sums for the track width: squares of the yaw rate, and its product with the difference
    of the wheels' speeds.
    turned_angle : rad, sum of the magnitudes of all heading changes.
    count : number of windows.
    verdict : sentence for the user, empty if there is none.
    usable_side : side, +1 or -1, of the only wheel that remains in use; 0.0 if none is excluded.
    sides_swapped : True if the usable wheel is in truth on the other side.
    other_wheel_steers : True if the other wheel may be steered.
    """

    track_width: float
    yaw_residual_squares: list[float] = field(default_factory=lambda: [0.0] * 4)
    wheel_distances: list[float] = field(default_factory=lambda: [0.0, 0.0])
    yaw_rate_squares: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    size_regression: list[float] = field(default_factory=lambda: [0.0, 0.0])
    track_regression: list[float] = field(default_factory=lambda: [0.0, 0.0])
    axle_misfit: float = 0.0
    turned_angle: float = 0.0
    count: int = 0
    verdict: str = ""
    usable_side: float = 0.0
    sides_swapped: bool = False
    other_wheel_steers: bool = False

    @property
    def is_undecided(self) -> bool:
        """Return True while more windows are needed."""
        return not self.verdict and self.count < _MAX_CHECK_WINDOWS

    def add(self, yaw_rates: tuple[float, float], left_speed: float, right_speed: float) -> float | None:
        """Add a window: yaw rates of the left and the right gyro, rad/s, and wheel speeds, m/s.

        Return the side to distrust, +1 or -1, or BOTH_WHEELS, once, when the two wheels are not the declared
        axle.
        """
        if max(abs(left_speed), abs(right_speed)) < _MIN_CHECK_SPEED:
            return None
        yaw_rate = 0.5 * (yaw_rates[0] + yaw_rates[1])
        self.wheel_distances[0] += left_speed * WINDOW_S
        self.wheel_distances[1] += right_speed * WINDOW_S
        self.turned_angle += abs(yaw_rate) * WINDOW_S
        self.count += 1
        first, second = yaw_rates
        yaw_squares, residual_squares = self.yaw_rate_squares, self.yaw_residual_squares
        yaw_squares[0] += first * first
        yaw_squares[1] += second * second
        yaw_squares[2] += (first - second) ** 2
        # As declared; left node reversed; right node reversed; both reversed or sides exchanged.
        declared, turned_rate = (
            (right_speed - left_speed) / self.track_width,
            (right_speed + left_speed) / self.track_width,
        )
        residual = (yaw_rate - declared) ** 2
        residual_squares[0] += residual
        residual_squares[1] += (yaw_rate - turned_rate) ** 2
        residual_squares[2] += (yaw_rate + turned_rate) ** 2
        residual_squares[3] += (yaw_rate + declared) ** 2
        self.track_regression[0] += yaw_rate * yaw_rate
        self.track_regression[1] += yaw_rate * (right_speed - left_speed)
        self._compare_sizes(yaw_rate - declared, turned_rate, 0.5 * (first * first + second * second))
        if self.count < WINDOWS_PER_SECOND:
            return None
        distrusted_side = self._check_steering() if self.count >= MANOEUVRE_WINDOWS else None
        if distrusted_side is None:
            distrusted_side = self._check_mounting()
        if distrusted_side is None and self.turned_angle > _MIN_TURNED_ANGLE:
            distrusted_side = self._check_axle()
        return distrusted_side

    def _compare_sizes(self, residual: float, turned_rate: float, yaw_rate_square: float) -> None:
        """Accumulate the yaw-rate residual of the wheel speeds that unequal wheel sizes do not explain.

        residual: rad/s; turned_rate: 1/s times twice the speed over the track; yaw_rate_square: (rad/s)². A
        window counts at most as `GATE_SIGMA` tolerances, so seconds of slip are not taken for a wrong axle.
        """
        tolerance = AXLE_YAW_RMS**2 + _SPEED_YAW_SHARE**2 * yaw_rate_square
        regression = self.size_regression
        if residual * residual < GATE_SIGMA**2 * (tolerance + (_MAX_SIZE_RATIO * turned_rate) ** 2):
            regression[0] += turned_rate * turned_rate
            regression[1] += turned_rate * residual
        size_ratio = (
            max(-_MAX_SIZE_RATIO, min(_MAX_SIZE_RATIO, regression[1] / regression[0]))
            if regression[0] > 0.0
            else 0.0
        )
        self.axle_misfit += (
            min((residual - size_ratio * turned_rate) ** 2, GATE_SIGMA**2 * tolerance) - tolerance
        )

    def _check_steering(self) -> float | None:
        """Return the side of the wheel that turns more, if the two yaw rates differ: it is steered."""
        difference, difference_square = (
            abs(self.yaw_rate_squares[0] - self.yaw_rate_squares[1]),
            self.yaw_rate_squares[2],
        )
        if difference_square < AXLE_YAW_RMS**2 * self.count + _GYRO_YAW_SHARE**2 * min(
            self.yaw_rate_squares[:2]
        ):
            return None
        if difference < _MIN_STEERING_SHARE * difference_square:
            return None
        side = 1.0 if self.yaw_rate_squares[0] > self.yaw_rate_squares[1] else -1.0
        self.usable_side, self.other_wheel_steers = -side, True
        self.verdict = (
            "the two wheels turn otherwise than each other: one of them steers, they are not on one axle, or "
            "the clock of one is late; say steered = true under the [nodes] table of one that steers"
        )
        return side

    def _check_axle(self) -> float | None:
        """Return a side if the wheel speeds do not belong to one axle of the declared width."""
        if self.axle_misfit < 0.0:
            return None
        self.usable_side, self.other_wheel_steers = 1.0, True
        self.verdict = (
            f"the speeds of the two wheels are not those of an axle of {self.track_width:g} m"
            f"{self._describe_width()}: nodes of two axles, or another track_width; see to the vehicle file"
        )
        return -1.0

    def _describe_width(self) -> str:
        """Return the track width estimated from speeds and gyros, as text; empty if it is implausible."""
        squares, product = self.track_regression
        width = product / squares if squares > 0.0 else 0.0
        if not 1.0 / _MAX_WIDTH_RATIO < width / self.track_width < _MAX_WIDTH_RATIO:
            return ""
        return f", they fit {width:.2g} m better"

    def _check_mounting(self) -> float | None:
        """Return the side to distrust if an undeclared mounting explains the yaw rate much better."""
        best_mounting = self.yaw_residual_squares.index(min(self.yaw_residual_squares))
        if best_mounting == 0 or self.yaw_residual_squares[0] < GATE_SIGMA**2 * (
            self.yaw_residual_squares[best_mounting] + AXLE_YAW_RMS**2 * self.count
        ):
            return None
        if best_mounting == 3:
            if max(self.wheel_distances) < 0.0:
                self.verdict = "both nodes are mounted the other way round: change both facings"
                return BOTH_WHEELS
            self.verdict = "the sides of the two nodes are exchanged: swap side in the vehicle file"
            self.usable_side, self.sides_swapped = 1.0, True
            return BOTH_WHEELS
        reversed_wheel = 0 if self.wheel_distances[0] < self.wheel_distances[1] else 1
        name = ("left", "right")[reversed_wheel]
        self.verdict = f"the node on the {name} wheel is mounted the other way round: change its facing"
        self.usable_side = (-1.0, 1.0)[reversed_wheel]
        return -self.usable_side
