"""The gyro bias that a node's firmware estimated, as a prior where no calibration gives one."""

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
    """Return the calibration with the bias last reported by each node, and these nodes' names.

    A bias in the calibration takes precedence. The wheel filter raises the sigma to its own minimum for
    another temperature and another day, and uses that minimum where the node does not know its sigma.
    """
    reporting_nodes = []
    for name in names:
        node = calibration.nodes.get(name) if calibration is not None else None
        table = recording.bias_filters.get(name)
        if table is None or (node is not None and "gyro_bias" in node.effects):
            continue
        effect = _read_last_bias(table)
        if effect is not None:
            calibration = (calibration or Calibration()).with_node(name, {"gyro_bias": effect})
            reporting_nodes.append(name)
    return calibration, tuple(reporting_nodes)


def _read_last_bias(table: Table) -> CalibratedEffect | None:
    """Return the bias in the last row in which the firmware was tracking, None without such a row."""
    is_tracking = table["state"] == FilterState.TRACKING
    if not is_tracking.any():
        return None
    parameters = {}
    for axis in XYZ:
        bias, sigma = (float(table[f"{what}_{axis}"][is_tracking][-1]) for what in ("bias", "sigma"))
        parameters[axis] = Quantity(bias, 0.0 if math.isnan(sigma) else sigma)
    return CalibratedEffect(parameters, method="bias filter of the node")
