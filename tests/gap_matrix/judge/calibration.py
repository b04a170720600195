"""Calibration of confidences: share of correct names by confidence, as a table and a diagram."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.stats import binomtest

from hubodo.report.drawing import new_figure, save_figure

EDGES = (0.0, 0.3, 0.5, 0.7, 0.8, 0.9, 0.99, 0.999, 1.0)
_INTERVAL = 0.9


@dataclass(frozen=True)
class Given:
    """A name with its confidence, and whether it is correct."""

    confidence: float
    right: bool


@dataclass(frozen=True)
class Bin:
    """Names with a confidence from low to high, and the exact 90 % interval of the share that is correct.

    interval: of the share that is right, exact, 90 %.
    """

    low: float
    high: float
    mean: float
    right: int
    count: int
    interval: tuple[float, float]

    @property
    def share(self) -> float:
        return self.right / self.count

    @property
    def words(self) -> str:
        last = 3 if self.low >= 0.99 else 2 if self.high > 0.9 else 1
        low, high = (100 * it for it in self.interval)
        return (
            f"{self.low:.{last}f} to {self.high:.{last}f}  mean {self.mean:.3f}  right {self.right:4d} of "
            f"{self.count:4d}  {100 * self.share:5.1f} % ({low:.0f}..{high:.0f})"
        )


def binned(given: Sequence[Given], edges: Sequence[float] = EDGES) -> list[Bin]:
    """Return the bins that contain names; each includes its lower edge, the last one both."""
    made = []
    for low, high in pairwise(edges):
        here = [it for it in given if low <= it.confidence < high or (it.confidence == high == edges[-1])]
        if not here:
            continue
        right = sum(it.right for it in here)
        found = binomtest(right, len(here)).proportion_ci(_INTERVAL, "exact")
        mean = float(np.mean([it.confidence for it in here]))
        made.append(Bin(low, high, mean, right, len(here), (float(found.low), float(found.high))))
    return made


def diagram(bins: Sequence[Bin], title: str, path: Path) -> None:
    """Write a diagram of the share of correct names over confidence, with intervals, as .png or .svg."""
    figure = new_figure(6.0, 4.6)
    axes = figure.add_subplot()
    # By place, not by value: most that matters lies between 0.9 and 1.
    place = np.arange(len(bins))
    share = np.array([it.share for it in bins])
    reach = np.abs(np.array([it.interval for it in bins]).T - share)
    for k, it in enumerate(bins):
        axes.fill_between([k - 0.4, k + 0.4], it.low, it.high, color="#d8dce0", lw=0)
        axes.plot([k - 0.4, k + 0.4], [it.mean] * 2, color="#1d2126", lw=1)
        axes.annotate(f"{it.count}", (k, 0.02), ha="center", fontsize=8, color="#1d2126")
    axes.errorbar(place, share, reach, fmt="o", color="#1b6ca8", capsize=3)
    axes.set_xticks(place, [f"{it.low:g} to\n{it.high:g}" for it in bins], fontsize=8)
    axes.set(
        xlabel="confidence that gap gives a name", ylabel="share of them that is right", ylim=(0.0, 1.02)
    )
    axes.set_title(title, fontsize=9)
    save_figure(figure, path)
