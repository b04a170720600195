"""Figure of limits: ratio of the smallest named sizes to the smallest detectable ones."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gap_matrix.limit.table import WANTED, Limit
from hubodo.report.drawing import new_figure, save_figure


def draw(limits: Sequence[Limit], path: Path) -> None:
    """Draw ratios to the sizes detected in 50 and 90 %, one row per effect, with every trial."""
    figure = new_figure(8.0, 1.2 + 0.26 * len(limits))
    axes = figure.add_subplot()
    for row, it in enumerate(limits):
        told = it.told_over_seen
        axes.barh(row, (WANTED - 1.0) * told, left=told, color="0.9", zorder=0)
        axes.plot([told, told], [row - 0.4, row + 0.4], color="0.3", zorder=2)
        spread = it.curve.spread(0.5)
        for seen, mark in ((True, "|"), (False, "x")):
            at = [np.exp(x) for x, named in it.trials if named is seen]
            axes.plot(at, [row] * len(at), mark, color="0.6", markersize=4, zorder=1)
        low, high = it.over_seen[0] * np.exp([-spread, spread])
        axes.plot([low, high], [row, row], color="C0", zorder=2)
        axes.plot(it.over_seen[0], row, "o", color="C0", zorder=3)
        axes.plot(it.over_seen[1], row, "o", color="C0", markerfacecolor="white", zorder=3)
    axes.set_yticks(range(len(limits)), [it.name for it in limits])
    axes.invert_yaxis()
    axes.set_xscale("log")
    axes.set_xlim(0.5, 6.0)
    axes.set_xticks([0.5, 1, 1.5, 2, 3, 5], ["0.5", "1", "1.5", "2", "3", "5"])
    axes.minorticks_off()
    axes.set_xlabel("size named over size that an oracle sees, in 50 % (filled) and 90 % of drives")
    axes.set_title(
        f"each trial: | named, x not; line: told by an oracle from all others; grey: to {WANTED} times",
        fontsize="small",
    )
    save_figure(figure, path)
