"""What two wheels tell about each other: rows that disagree, slip, and nodes mounted the wrong way round."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel.window import WINDOW_S

GATE_SIGMA = 3.0
"""Sigma beyond which a row loses weight: of honest ones, one in 370 does."""

BOTH_WHEELS = 0.0
"""Verdict of `Agreement`: both wheels are to be distrusted."""

_MOVES = 0.1
"""m/s below which a wheel says nothing about its mounting: a tenth of walking pace. Estimated."""

_ENOUGH, _SURE = 10, 3000
"""Windows: a second for a verdict, so that one bump makes none.

Five minutes until all is taken to be as declared. Estimated.
"""

_FITS, _SAME = 0.2, 0.02
"""rad/s: rms by which a mounting may miss the yaw rate of the gyros and still explain it.

And how well the right one is sure to meet it, 1 % of brisk turns. Estimated.
"""

_STEERS, _LONG, _CLEAR = (0.03, 0.1), 20, 0.5
"""rad/s, and a share of the yaw rate, rms by which two nodes on one axle may feel another yaw.

On real drives they do so by 0.005 rad/s (a car) and 0.03 at 0.6 rad/s (a wheelchair). Windows, two seconds,
before that is judged. By which share of the squares of that difference one wheel has to turn more than the
other before it is named: it does by all of them in the long run, as what one wheel turns beyond the vehicle
does not go along with the vehicle's own turning, but for where it began. Estimated.
"""

_APART, _TURNED = (0.04, 0.2), 3.0
"""The same for the yaw that the wheels' speeds make and the one that the gyros feel; rad of turning it takes.
Tapes are wrong by a tenth at most. Estimated."""

_SIZES = 0.05
"""Half of the share by which one wheel may seem to roll farther in a turn than the other: tapes, and gyros
that nobody calibrated, differ by a few hundredths. Wheels of two axles differ by what they steer.
Estimated."""

_AT_MOST = 4.0
"""Times that difference, which a window counts for at most: a wheel that slips for seconds is no other axle.
Estimated."""

_WORSE = 6.0
"""How many times the squares of the declared mounting must be those of another one.

Two and a half times its rms. Estimated; a curve soon makes it hundreds.
"""

_TAPE, _TOLD = 0.005, 0.01
"""Fractions, 1 sigma: a track measured with care; how well a drive must show it before that is asked.

A tape between the tyres' middles; turns of half a circle show so much. Estimated.
"""


def track_width_test(error: float, variance: float, prior: float) -> float | None:
    """The variance with which a drive's track error is to be told that it is zero; None: not (yet).

    Was the track measured with care, sigma `_TAPE`, or just anyhow, sigma `prior`? Care has to be more likely
    by a third, given the track that the turns show: a wrong word bends every turn, one
    that is not heard costs little. error, variance: of the track by now, a fraction, with the wide prior in
    it.
    """
    shown = 1.0 / (1.0 / variance - 1.0 / prior**2) if variance < prior**2 else math.inf
    if shown > _TOLD**2:
        return None
    seen = error * shown / variance
    careful, loose = shown + _TAPE**2, shown + prior**2
    if seen * seen * (1.0 / careful - 1.0 / loose) > math.log(loose / careful) - 0.5:
        return math.inf
    return _TAPE**2


def inflate_outlier_variances(
    white: Array,
    sigma: Array,
    residuals: Array,
    variances: Array,
    compared: Sequence[tuple[int, int]] | None,
) -> tuple[Array, int | None]:
    """Variances under which no row stands out by more than three sigma, and the wheel found slipping, if any.

    white: innovations, each given the rows before it, in units of `sigma`; residuals: as they are.
    compared: where all rows of two wheels are there, those of yaw and rolling of each. Of two yaw rates that
    disagree both lose weight alike; of two wheels that roll apart the one that has left the speed which the
    accelerometers carried over: it slips.
    """
    out = np.abs(white) > GATE_SIGMA
    if not out.any():
        return variances, None
    extra = np.where(out, (white * white / GATE_SIGMA**2 - 1.0) * sigma * sigma, 0.0)
    slipping = None
    if compared is not None:
        (first_yaw, first), (second_yaw, second) = compared
        extra[first_yaw] = max(extra[first_yaw], extra[second_yaw])
        if out[second]:
            slipping = 0 if abs(residuals[first]) > abs(residuals[second]) else 1
            slipped = compared[slipping][1]
            extra[second] = 0.0
            extra[slipped] += residuals[slipped] ** 2
    return variances + extra, slipping


@dataclass
class MountingCheck:
    """Is the yaw that the wheels' difference makes the yaw that their gyros feel, or another mounting's?

    The gyros across the axle feel the same yaw whichever way a node faces; the wheels' speeds change sign
    with the facing and change places with the side. A wheel that steers turns its node besides: it feels the
    yaw of the vehicle and its own, more than the other at every pace of turning. track: m. alone: the side,
    +1 or -1, of the wheel that may still be used after a verdict, 0.0 for neither. exchanged: whether that
    one sits on the other side; steering: whether the
    other one may steer. sizes: of twice the speed over the track, its squares, and what is off times it.
    """

    track_width: float
    yaw_residual_squares: list[float] = field(default_factory=lambda: [0.0] * 4)
    wheel_distances: list[float] = field(default_factory=lambda: [0.0, 0.0])
    yaw_rate_squares: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    size_regression: list[float] = field(default_factory=lambda: [0.0, 0.0])
    axle_misfit: float = 0.0
    turned_angle: float = 0.0
    count: int = 0
    verdict: str = ""
    usable_side: float = 0.0
    sides_swapped: bool = False
    other_wheel_steers: bool = False

    @property
    def is_undecided(self) -> bool:
        """Whether more windows are wanted: no verdict yet, and not yet sure that all is as declared."""
        return not self.verdict and self.count < _SURE

    def add(self, yaws: tuple[float, float], left: float, right: float) -> float | None:
        """One window: yaw rates that the gyros of the left and the right wheel feel, rad/s, speeds, m/s.

        Returns once, when the two wheels are not the axle that was declared: the side to distrust, +1 or -1,
        or BOTH.
        """
        if max(abs(left), abs(right)) < _MOVES:
            return None
        yaw_rate = 0.5 * (yaws[0] + yaws[1])
        self.wheel_distances[0] += left * WINDOW_S
        self.wheel_distances[1] += right * WINDOW_S
        self.turned_angle += abs(yaw_rate) * WINDOW_S
        self.count += 1
        first, second = yaws
        felt, squares = self.yaw_rate_squares, self.yaw_residual_squares
        felt[0] += first * first
        felt[1] += second * second
        felt[2] += (first - second) ** 2
        # As declared; the left node the other way round; the right one; both, or the sides exchanged.
        declared, turned = (right - left) / self.track_width, (right + left) / self.track_width
        off = (yaw_rate - declared) ** 2
        squares[0] += off
        squares[1] += (yaw_rate - turned) ** 2
        squares[2] += (yaw_rate + turned) ** 2
        squares[3] += (yaw_rate + declared) ** 2
        self._compare_sizes(yaw_rate - declared, turned, 0.5 * (first * first + second * second))
        if self.count < _ENOUGH:
            return None
        blamed = self._steering() if self.count >= _LONG else None
        if blamed is None:
            blamed = self._mounting()
        if blamed is None and self.turned_angle > _TURNED:
            blamed = self._apart()
        return blamed

    def _compare_sizes(self, off: float, turned: float, squared: float) -> None:
        """Sums up by how much the yaw of the wheels' speeds is off, rad/s, but for wheels of unequal size.

        turned: 1/s times twice the speed over the track; squared: (rad/s)² of the yaw rate.
        """
        allowed = _APART[0] ** 2 + _APART[1] ** 2 * squared
        sizes = self.size_regression
        if off * off < _AT_MOST**2 * (allowed + (_SIZES * turned) ** 2):
            sizes[0] += turned * turned
            sizes[1] += turned * off
        unequal = max(-_SIZES, min(_SIZES, sizes[1] / sizes[0])) if sizes[0] > 0.0 else 0.0
        self.axle_misfit += min((off - unequal * turned) ** 2, _AT_MOST**2 * allowed) - allowed

    def _steering(self) -> float | None:
        """Two yaws that differ: the wheel that turns more is the one that steers."""
        more, apart = abs(self.yaw_rate_squares[0] - self.yaw_rate_squares[1]), self.yaw_rate_squares[2]
        if apart < _STEERS[0] ** 2 * self.count + _STEERS[1] ** 2 * min(self.yaw_rate_squares[:2]):
            return None
        if more < _CLEAR * apart:
            return None
        side = 1.0 if self.yaw_rate_squares[0] > self.yaw_rate_squares[1] else -1.0
        self.usable_side, self.other_wheel_steers = -side, True
        self.verdict = (
            "the two wheels turn otherwise than each other: one of them steers, or they are not on one axle; "
            "say steered = true under the [nodes] table of the one that does"
        )
        return side

    def _apart(self) -> float | None:
        """Speeds that make another yaw than the gyros feel: the two wheels are not one axle of that track."""
        if self.axle_misfit < 0.0:
            return None
        self.usable_side, self.other_wheel_steers = 1.0, True
        self.verdict = (
            f"the speeds of the two wheels are not those of an axle of {self.track_width:g} m: nodes of two "
            "axles, or another track_width; see to the vehicle file"
        )
        return -1.0

    def _mounting(self) -> float | None:
        """Another mounting that explains the yaw much better."""
        best = self.yaw_residual_squares.index(min(self.yaw_residual_squares))
        fits = self.yaw_residual_squares[best] < _FITS**2 * self.count
        if (
            best == 0
            or not fits
            or self.yaw_residual_squares[0]
            < _WORSE * (self.yaw_residual_squares[best] + _SAME**2 * self.count)
        ):
            return None
        if best == 3:
            if max(self.wheel_distances) < 0.0:
                self.verdict = "both nodes are mounted the other way round: change both facings"
                return BOTH_WHEELS
            self.verdict = "the sides of the two nodes are exchanged: swap side in the vehicle file"
            self.usable_side, self.sides_swapped = 1.0, True
            return BOTH_WHEELS
        backwards = 0 if self.wheel_distances[0] < self.wheel_distances[1] else 1
        name = ("left", "right")[backwards]
        self.verdict = f"the node on the {name} wheel is mounted the other way round: change its facing"
        self.usable_side = (-1.0, 1.0)[backwards]
        return -self.usable_side
