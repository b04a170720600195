"""Spikes in the samples of wheel nodes, as bit errors of a cable or a bus make."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hubodo.recording import Table

_RANGES = {"g": 34.9, "a": 157.0}
"""rad/s and m/s², 2000 °/s and 16 g."""


def with_spikes(nodes: Mapping[str, Table], share: float, seed: int) -> dict[str, Table]:
    """Return the nodes with this share of the values of each channel drawn from the whole range."""
    rng = np.random.default_rng([seed, 34])
    spiked = {}
    for name, table in nodes.items():
        columns = dict(table.columns)
        for channel in ("gx", "gy", "gz", "ax", "ay", "az"):
            limit, hit = _RANGES[channel[0]], rng.uniform(size=len(table)) < share
            columns[channel] = np.where(hit, rng.uniform(-limit, limit, len(table)), columns[channel])
        spiked[name] = Table(columns)
    return spiked
