"""Changes of the filter state, whose types say whether a replay of the windows reproduces them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from hubodo.arrays import Array


@dataclass(frozen=True, eq=False)
class Correction:
    """A correction of states and covariance: x + change, p - reduction; (n,) and (n, n)."""

    change: Array
    reduction: Array
    is_replayable: ClassVar[bool] = False


class WindowCorrection(Correction):
    """A correction derived from the windows of a step, repeated by a replay."""

    is_replayable: ClassVar[bool] = True


class ExternalCorrection(Correction):
    """A correction from outside the windows: position, surface speed, track width, mounting, standstill."""


@dataclass(frozen=True, eq=False)
class StateReset:
    """States that their owner has reset in place: wheel angle, rate beyond range, or all after an outage.

    columns: states that carry no information about the past any more.
    """

    columns: Sequence[int]
    is_replayable: ClassVar[bool] = False
