"""Residuals in words: which channels an effect changed and when, and how look-alikes are told apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hubodo.arrays import Array
from hubodo.effects import distinguishing_manoeuvre
from hubodo.gap.explain.regimes import Regimes, compute_trajectory, describe_interval
from hubodo.gap.problem.problem import CHANNELS, NodeData
from hubodo.gap.process_noise.residual import Residual

# Channels that are named: the three that show most, none that shows less than so much of the first.
_MAX_NAMED_CHANNELS, _MIN_CHANNEL_SHARE = 3, 0.25
_GENERIC_MANOEUVRE = "vary speed, turns and temperature more, for longer"


def describe_manoeuvre(name: str, others: Sequence[str]) -> str:
    """What would tell an effect from those that this log cannot tell it from."""
    ways = ((other, distinguishing_manoeuvre(name, other) or _GENERIC_MANOEUVRE) for other in others)
    return "; ".join(f"to tell it from {other}, {way}" for other, way in ways)


def describe_where(before: Mapping[str, Residual], after: Mapping[str, Residual]) -> str:
    """The channels that asked for the change of the model, when and with what it goes; the strongest first.

    A channel's significance is that of its residual before along the change: (r · c) / |c| in declared sigma.
    """
    rows = []
    for name, residual in before.items():
        change = (after[name].predicted - residual.predicted) / residual.declared_sigma
        for row in np.flatnonzero(residual.node.used):
            size = float(np.linalg.norm(change[row]))
            if size > 0.0:
                sigmas = float(residual.value[row] / residual.declared_sigma[row] @ change[row]) / size
                rows.append((sigmas, name, int(row), change[row]))
    rows.sort(key=lambda it: -it[0])
    if not rows or rows[0][0] < 2.0:
        return "in no channel by itself"
    tables: dict[str, Regimes] = {}
    parts = []
    for sigmas, name, channel, series in rows[:_MAX_NAMED_CHANNELS]:
        if sigmas < max(_MIN_CHANNEL_SHARE * rows[0][0], 2.0):
            break
        node = before[name].node
        if name not in tables:
            tables[name] = Regimes(compute_trajectory(node))
        parts.append(
            f"{name}.{CHANNELS[channel]}, {_describe_series(tables[name], node, series)}, {sigmas:.0f} σ"
        )
    return "; ".join(parts)


def _describe_series(regimes: Regimes, node: NodeData, series: Array) -> str:
    words = regimes.find_regime(series).words
    stretch = "" if " from " in f" {words}" else describe_interval(node.t, series)
    return f"{words}, {stretch}" if stretch else words
