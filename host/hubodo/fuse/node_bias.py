"""What a node's own filter found of its gyro's bias, as a prior where no calibration tells it."""

from __future__ import annotations

import math
from collections.abc import Iterable

from hubodo.calibration.file import CalibratedEffect, Calibration, Quantity
from hubodo.effects.triad import XYZ
from hubodo.recording import Recording, Table
from hubowire.messages import FilterState


def add_node_biases(
    calibration: Calibration | None, recording: Recording, names: Iterable[str]
) -> tuple[Calibration | None, tuple[str, ...]]:
    """The calibration with the last bias that each node told of itself, and the nodes for which it did.

    A node whose bias a calibration knows keeps that. The filter takes no bias for surer than its own floor
    for another temperature and another day, however sure the node was of its initialisation; where the node
    does not know a sigma, that floor is all there is.
    """
    used = []
    for name in names:
        known = calibration.nodes.get(name) if calibration is not None else None
        table = recording.bias_filters.get(name)
        if table is None or (known is not None and "gyro_bias" in known.effects):
            continue
        effect = _read_last_bias(table)
        if effect is not None:
            calibration = (calibration or Calibration()).with_node(name, {"gyro_bias": effect})
            used.append(name)
    return calibration, tuple(used)


def _read_last_bias(table: Table) -> CalibratedEffect | None:
    tracking = table["state"] == FilterState.TRACKING
    if not tracking.any():
        return None
    found = {}
    for axis in XYZ:
        bias, sigma = (float(table[f"{what}_{axis}"][tracking][-1]) for what in ("bias", "sigma"))
        found[axis] = Quantity(bias, 0.0 if math.isnan(sigma) else sigma)
    return CalibratedEffect(found, method="the node's own filter")
