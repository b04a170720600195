"""Accelerations that stand out alone, as after bit errors or a loose contact, replaced by their neighbours.

A spike, of one sample or two, leaves the median of five samples by more than a physical floor and by many
times the usual change from sample to sample around it. A shock of the road rings for several samples, and
vibration is the usual change. Those of the gyros are left out by `wheel/glitches.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.recording import NODE_COLUMNS, Recording, Table

_MIN_SPIKE = 20.0
"""m/s²; smaller spikes change a window of 0.1 s by less than vibration does. Estimated."""

_MIN_CHANGE_RATIO, _NEIGHBOURHOOD = 12.0, 25
"""Ratio of a spike to the median change from sample to sample, and the number of samples on either side of
which it is taken: on real wheels, on hubs and rims, nothing else reaches it but shocks."""

_MIN_RINGING_RATIO, _RINGING_SAMPLES, _RINGING_QUANTILE = 4.0, 5, 0.6
"""Ratio of a spike to a quantile of the changes within a number of samples on either side: a shock that
rings changes most of them. The quantile lets a second spike be near."""


_MANY_SPIKES_SHARE = 0.01
"""Share of the samples from which on some spikes pass undetected beside others, and sigmas are too small:
NEES 7 to 18 of 3 with spikes in 3 % of the samples (`tests/accuracy/spikes.py`)."""

_MANY_SPIKES = "; at this rate the sigmas are too small: check cable, supply and bus"


def remove_spikes(recording: Recording, names: Sequence[str]) -> tuple[Recording, tuple[str, ...]]:
    """Return the recording with the spikes of these nodes replaced, and a warning for each that had some."""
    nodes, warnings = dict(recording.nodes), []
    for name in names:
        table = nodes[name]
        cleaned, count = _clean_columns(table)
        if count:
            nodes[name] = Table({**table.columns, **cleaned}, table.t_ns)
            warnings.append(
                f"{name}: {count} of {len(table)} samples stand out alone in {', '.join(cleaned)}, as by "
                "shocks or bit errors; replaced by their neighbours"
                + ("" if count < _MANY_SPIKES_SHARE * len(table) else _MANY_SPIKES)
            )
    return (replace(recording, nodes=nodes), tuple(warnings)) if warnings else (recording, ())


def _clean_columns(table: Table) -> tuple[dict[str, Array], int]:
    """Return the columns that had spikes, without them, and the number of samples with a spike."""
    cleaned, is_spike = {}, np.zeros(len(table), bool)
    for column in NODE_COLUMNS[4:]:
        values = table[column]
        spikes = find_spikes(values)
        if len(spikes):
            is_spike[spikes] = True
            others = np.setdiff1d(np.arange(len(values)), spikes)
            cleaned[column] = values.copy()
            cleaned[column][spikes] = np.interp(table.t[spikes], table.t[others], values[others])
    return cleaned, int(np.count_nonzero(is_spike))


def find_spikes(values: Array) -> NDArray[np.intp]:
    """Return the indices of accelerations, m/s², that stand out from their neighbours."""
    if len(values) < 2 * _NEIGHBOURHOOD:
        return np.empty(0, np.intp)
    change = np.abs(np.diff(values))
    edges = np.flatnonzero(change > _MIN_SPIKE)
    candidates = np.union1d(edges, edges + 1)
    neighbours = np.clip(candidates[:, None] + np.arange(-2, 3), 0, len(values) - 1)
    height = np.abs(values[candidates] - np.median(values[neighbours], axis=1))
    candidates, height = candidates[height > _MIN_SPIKE], height[height > _MIN_SPIKE]
    threshold = [_local_threshold(change, at) for at in candidates.tolist()]
    spikes: NDArray[np.intp] = candidates[height > threshold]
    return spikes


def _local_threshold(change: Array, index: int) -> float:
    """Return the height of a spike at a sample, given the changes (N - 1,) between samples around it."""
    first = min(max(index - _NEIGHBOURHOOD, 0), len(change) - 2 * _NEIGHBOURHOOD)
    usual = float(np.median(change[first : first + 2 * _NEIGHBOURHOOD]))
    near = np.sort(change[max(0, index - _RINGING_SAMPLES) : index + _RINGING_SAMPLES])
    ringing = float(near[int(_RINGING_QUANTILE * (len(near) - 1))])
    return max(_MIN_CHANGE_RATIO * usual, _MIN_RINGING_RATIO * ringing)
