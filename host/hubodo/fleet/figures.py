"""Figures of the fleet page: distribution and drift of a quantity, map of a missing effect."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from hubodo.pages.drawing import Drawing, new_figure, render_drawing
from hubodo.pages.page import COLOURS

_N_HISTOGRAM_BINS = 40
_EXTRA_COLOURS = ("#8e5ea2", "#c78a1e", "#2e7d5b", "#5d646c")
_MAX_MAP_ROWS = 60


def spread_figure(numbers: pd.DataFrame, label: str) -> Drawing:
    """Draw, by node, a histogram (left) and the daily median with a band from 5 to 95 % (right)."""

    def draw() -> Any:
        figure = new_figure(9.0, 2.8)
        left, right = figure.subplots(1, 2, width_ratios=(1, 2))
        values = numbers.value.to_numpy(float)
        edges = np.histogram_bin_edges(_trim_extremes(values), _N_HISTOGRAM_BINS)
        for number, (node, group) in enumerate(numbers.groupby("node")):
            colour = COLOURS.get(str(node), _EXTRA_COLOURS[number % len(_EXTRA_COLOURS)])
            inside = np.clip(group.value.to_numpy(float), edges[0], edges[-1])
            left.hist(inside, edges, histtype="step", color=colour, label=str(node) or "log")
            dated = group.dropna(subset=["start"])
            if dated.empty:
                continue
            daily = dated.set_index("start").value.resample("D")
            low, middle, high = (daily.quantile(share).dropna() for share in (0.05, 0.5, 0.95))
            right.fill_between(low.index, low, high, color=colour, alpha=0.2, lw=0)
            right.plot(middle.index, middle, color=colour, marker=".", ms=3, lw=0.8)
        left.set_xlabel(label)
        left.set_ylabel("logs")
        left.locator_params(axis="x", nbins=4)
        right.set_ylabel(label)
        right.tick_params(axis="x", labelrotation=30)
        if numbers.node.nunique() > 1:
            left.legend(fontsize=8, frameon=False)
        return figure

    return render_drawing(draw)


def effect_map(shares: pd.DataFrame, effect: str) -> Drawing:
    """Draw vehicles against weeks, coloured by the share of logs in which the effect is missing."""
    shown = shares.loc[shares.max(axis=1).sort_values(ascending=False, kind="stable").index[:_MAX_MAP_ROWS]]

    def draw() -> Any:
        figure = new_figure(9.0, 0.9 + 0.18 * len(shown))
        axes = figure.subplots()
        axes.set_facecolor("#e6e8ea")
        image = axes.pcolormesh(
            shown.to_numpy(float), cmap="Blues", vmin=0.0, vmax=1.0, edgecolors="w", lw=0.4
        )
        axes.set_yticks(np.arange(len(shown)) + 0.5, [str(name) for name in shown.index], fontsize=7)
        weeks = [f"{week:%Y-%m-%d}" for week in shown.columns]
        step = max(1, len(weeks) // 12)
        axes.set_xticks(np.arange(len(weeks))[::step] + 0.5, weeks[::step], fontsize=7, rotation=30)
        axes.invert_yaxis()
        axes.set_title(effect, fontsize=9, loc="left")
        figure.colorbar(image, ax=axes, label="share of logs")
        return figure

    return render_drawing(draw)


def _trim_extremes(values: Any) -> Any:
    """Return the values within 1.5 times the range from the 1st to the 99th percentile."""
    low, high = np.percentile(values, [1, 99])
    margin = 0.25 * (high - low)
    return values[(values >= low - margin) & (values <= high + margin)]
