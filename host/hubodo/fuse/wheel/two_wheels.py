"""What two wheels tell about each other: rows that disagree, slip, and nodes mounted the wrong way round."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel.preintegration import WINDOW

GATE = 3.0
"""Sigma beyond which a row loses weight: of honest ones, one in 370 does."""

BOTH = 0.0
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

_WORSE = 6.0
"""How many times the squares of the declared mounting must be those of another one.

Two and a half times its rms. Estimated; a curve soon makes it hundreds.
"""


def robust_variances(
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
    out = np.abs(white) > GATE
    if not out.any():
        return variances, None
    extra = np.where(out, (white * white / GATE**2 - 1.0) * sigma * sigma, 0.0)
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
class Agreement:
    """Is the yaw that the wheels' difference makes the yaw that their gyros feel, or another mounting's?

    The gyros across the axle feel the same yaw whichever way a node faces; the wheels' speeds change sign
    with the facing and change places with the side. track: m.
    """

    track: float
    squares: list[float] = field(default_factory=lambda: [0.0] * 4)
    travel: list[float] = field(default_factory=lambda: [0.0, 0.0])
    count: int = 0
    verdict: str = ""

    @property
    def open(self) -> bool:
        """Whether more windows are wanted: no verdict yet, and not yet sure that all is as declared."""
        return not self.verdict and self.count < _SURE

    def add(self, yaw_rate: float, left: float, right: float) -> float | None:
        """One window: yaw rate of the gyros, rad/s, speeds of the wheels, m/s.

        Returns once, when another mounting explains what was seen much better: the side to distrust, +1 or
        -1, or BOTH.
        """
        if max(abs(left), abs(right)) < _MOVES:
            return None
        self.travel[0] += left * WINDOW
        self.travel[1] += right * WINDOW
        self.count += 1
        guesses = (right - left, right + left, -right - left, left - right)
        for index, guess in enumerate(guesses):
            self.squares[index] += (yaw_rate - guess / self.track) ** 2
        if self.count < _ENOUGH:
            return None
        best = min(range(4), key=lambda index: self.squares[index])
        fits = self.squares[best] < _FITS**2 * self.count
        if best == 0 or not fits or self.squares[0] < _WORSE * (self.squares[best] + _SAME**2 * self.count):
            return None
        if best == 3:
            self.verdict = "the sides of the two nodes are exchanged: swap side in the vehicle file"
            if max(self.travel) < 0.0:
                self.verdict = "both nodes are mounted the other way round: change both facings"
            return BOTH
        backwards = 0 if self.travel[0] < self.travel[1] else 1
        name = ("left", "right")[backwards]
        self.verdict = f"the node on the {name} wheel is mounted the other way round: change its facing"
        return (1.0, -1.0)[backwards]
