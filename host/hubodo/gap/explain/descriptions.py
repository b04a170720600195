"""Descriptions of residuals: channels and regimes that an effect changed, and its look-alikes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hubodo.arrays import Array
from hubodo.effects import distinguishing_manoeuvre
from hubodo.effects.empirical import PREFIX
from hubodo.gap.explain.regimes import Regimes, compute_trajectory, describe_interval
from hubodo.gap.problem.problem import CHANNELS, NodeData
from hubodo.gap.process_noise.residual import Residual

# Channels named at most, in order of significance, and smallest share of the most significant one.
_MAX_NAMED_CHANNELS, _MIN_CHANNEL_SHARE = 3, 0.25
_GENERIC_MANOEUVRE = "vary speed, turns and temperature more, for longer"


def list_alternatives(others: Sequence[str]) -> list[str]:
    """Return names for people: terms without a name, which differ in little, are one."""
    named = [other for other in others if not other.startswith(PREFIX)]
    return [*named, *(["an unnamed term"] if len(named) < len(others) else [])]


def describe_manoeuvre(name: str, others: Sequence[str]) -> str:
    """Return the manoeuvres that would distinguish an effect from others, each with all that it excludes."""
    alternatives = dict[str, list[str]]()
    for other in list_alternatives(others):
        alternatives.setdefault(distinguishing_manoeuvre(name, other) or _GENERIC_MANOEUVRE, []).append(other)
    return "; ".join(
        f"to distinguish it from {' or '.join(names)}, {manoeuvre}"
        for manoeuvre, names in alternatives.items()
    )


def describe_where(before: Mapping[str, Residual], after: Mapping[str, Residual]) -> str:
    """Return the channels that required a change of the model, with regime and time.

    The most significant come first. Significance is that of the previous residual r along the change c: (r ·
    c) / |c| in declared sigma.
    """
    rows = []
    for name, residual in before.items():
        change = (after[name].predicted - residual.predicted) / residual.declared_sigma
        for row in np.flatnonzero(residual.node.used):
            size = float(np.linalg.norm(change[row]))
            if size > 0.0:
                sigmas = float(residual.value[row] / residual.declared_sigma[row] @ change[row]) / size
                rows.append((sigmas, name, int(row), change[row]))
    rows.sort(key=lambda row: -row[0])
    if not rows or rows[0][0] < 2.0:
        return "in no channel by itself"
    tables: dict[str, Regimes] = {}
    descriptions = []
    for sigmas, name, channel, series in rows[:_MAX_NAMED_CHANNELS]:
        if sigmas < max(_MIN_CHANNEL_SHARE * rows[0][0], 2.0):
            break
        node = before[name].node
        if name not in tables:
            tables[name] = Regimes(compute_trajectory(node))
        descriptions.append(
            f"{name}.{CHANNELS[channel]}, {_describe_series(tables[name], node, series)}, {sigmas:.0f} σ"
        )
    return "; ".join(descriptions)


def _describe_series(regimes: Regimes, node: NodeData, series: Array) -> str:
    words = regimes.find_regime(series).description
    stretch = "" if " from " in f" {words}" else describe_interval(node.t, series)
    return f"{words}, {stretch}" if stretch else words
