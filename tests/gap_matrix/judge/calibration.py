"""Calibration of confidences: share of correct names by confidence, as a table and a diagram."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.stats import binomtest

from hubodo.pages.drawing import new_figure, save_figure

CONFIDENCE_EDGES = (0.0, 0.3, 0.5, 0.7, 0.8, 0.9, 0.99, 0.999, 1.0)
_INTERVAL_PROBABILITY = 0.9


@dataclass(frozen=True)
class GivenName:
    """A name given by a diagnosis, its confidence, and whether it is correct."""

    confidence: float
    is_correct: bool


@dataclass(frozen=True)
class ConfidenceBin:
    """Names with a confidence from `low` to `high`.

    mean: mean confidence
    n_correct, count: correct names, all names
    interval: exact 90 % confidence interval of the share of correct names
    """

    low: float
    high: float
    mean: float
    n_correct: int
    count: int
    interval: tuple[float, float]

    @property
    def share(self) -> float:
        """Return the share of correct names."""
        return self.n_correct / self.count

    def describe(self) -> str:
        """Return the bin as a line of a table."""
        decimals = 3 if self.low >= 0.99 else 2 if self.high > 0.9 else 1
        low, high = (100 * it for it in self.interval)
        return (
            f"{self.low:.{decimals}f} to {self.high:.{decimals}f}  mean {self.mean:.3f}  "
            f"correct {self.n_correct:4d} of {self.count:4d}  "
            f"{100 * self.share:5.1f} % ({low:.0f}..{high:.0f})"
        )


def bin_names(given: Sequence[GivenName], edges: Sequence[float] = CONFIDENCE_EDGES) -> list[ConfidenceBin]:
    """Return the bins that contain names; each includes its lower edge, the last one both."""
    bins = []
    for low, high in pairwise(edges):
        in_bin = [it for it in given if low <= it.confidence < high or (it.confidence == high == edges[-1])]
        if not in_bin:
            continue
        n_correct = sum(it.is_correct for it in in_bin)
        interval = binomtest(n_correct, len(in_bin)).proportion_ci(_INTERVAL_PROBABILITY, "exact")
        mean = float(np.mean([it.confidence for it in in_bin]))
        bins.append(
            ConfidenceBin(
                low, high, mean, n_correct, len(in_bin), (float(interval.low), float(interval.high))
            )
        )
    return bins


def draw_diagram(bins: Sequence[ConfidenceBin], title: str, path: Path) -> None:
    """Write a diagram of the share of correct names over confidence, with intervals, as .png or .svg."""
    figure = new_figure(6.0, 4.6)
    axes = figure.add_subplot()
    # Bins are equally spaced, since most of the important ones lie between 0.9 and 1.
    position = np.arange(len(bins))
    share = np.array([it.share for it in bins])
    error_bars = np.abs(np.array([it.interval for it in bins]).T - share)
    for k, it in enumerate(bins):
        axes.fill_between([k - 0.4, k + 0.4], it.low, it.high, color="#d8dce0", lw=0)
        axes.plot([k - 0.4, k + 0.4], [it.mean] * 2, color="#1d2126", lw=1)
        axes.annotate(f"{it.count}", (k, 0.02), ha="center", fontsize=8, color="#1d2126")
    axes.errorbar(position, share, error_bars, fmt="o", color="#1b6ca8", capsize=3)
    axes.set_xticks(position, [f"{it.low:g} to\n{it.high:g}" for it in bins], fontsize=8)
    axes.set(xlabel="confidence stated by gap", ylabel="share of correct names", ylim=(0.0, 1.02))
    axes.set_title(title, fontsize=9)
    save_figure(figure, path)
