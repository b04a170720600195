"""Figure of limits: smallest size that `gap` names over the smallest size that an oracle detects."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gap_matrix.limit.table import MAX_RATIO, EffectLimit
from hubodo.pages.drawing import new_figure, save_figure


def draw_figure(limits: Sequence[EffectLimit], path: Path) -> None:
    """Draw the ratios at 50 and 90 % of the drives, one row per effect, with every trial."""
    figure = new_figure(8.0, 1.2 + 0.26 * len(limits))
    axes = figure.add_subplot()
    for row, limit in enumerate(limits):
        ratio = limit.identified_over_detected
        axes.barh(row, (MAX_RATIO - 1.0) * ratio, left=ratio, color="0.9", zorder=0)
        axes.plot([ratio, ratio], [row - 0.4, row + 0.4], color="0.3", zorder=2)
        sigma = limit.curve.ln_size_sigma(0.5)
        for is_named, marker in ((True, "|"), (False, "x")):
            ratios = [np.exp(ln_size) for ln_size, named in limit.trials if named is is_named]
            axes.plot(ratios, [row] * len(ratios), marker, color="0.6", markersize=4, zorder=1)
        low, high = limit.named_over_detected[0] * np.exp([-sigma, sigma])
        axes.plot([low, high], [row, row], color="C0", zorder=2)
        axes.plot(limit.named_over_detected[0], row, "o", color="C0", zorder=3)
        axes.plot(limit.named_over_detected[1], row, "o", color="C0", markerfacecolor="white", zorder=3)
    axes.set_yticks(range(len(limits)), [limit.name for limit in limits])
    axes.invert_yaxis()
    axes.set_xscale("log")
    axes.set_xlim(0.5, 6.0)
    axes.set_xticks([0.5, 1, 1.5, 2, 3, 5], ["0.5", "1", "1.5", "2", "3", "5"])
    axes.minorticks_off()
    axes.set_xlabel("size named by gap over size detected by an oracle, in 50 % (filled) and 90 % of drives")
    axes.set_title(
        f"each trial: | named, x not; line: size identified by an oracle; grey: {MAX_RATIO} times that",
        fontsize="small",
    )
    save_figure(figure, path)
