"""The odometer uses the measurement ranges that a node reports at its start."""

from __future__ import annotations

import numpy as np
import pytest

from generators.clipped_drives import CASES, clipped_drive
from hubodo.ingest.live.odometer import Odometer
from hubodo.log.records import ImuBlock
from hubodo.vehicle import NodeMount, Vehicle

SEED = 100
CASE = CASES["500 °/s at 4 m/s"]
VEHICLE = Vehicle(CASE.radius, CASE.track, {"left": NodeMount("left", "left")})


@pytest.mark.parametrize(
    ("reported_ranges", "max_error"), [({"gyro_range_dps": "500", "accel_range_g": "16"}, 0.01), ({}, None)]
)
def test_the_distance_of_a_clipped_gyro_is_estimated_if_the_node_reports_its_range(
    reported_ranges: dict[str, str], max_error: float | None
) -> None:
    drive = clipped_drive(CASE, SEED)
    node, odometer = drive.nodes["left"], Odometer(VEHICLE, 0, rate_hz=10.0)
    odometer.update_ranges("left", reported_ranges)
    odometer.update_ranges("frame", reported_ranges)
    t_ns = np.round(node.t * 1e9).astype(np.int64)
    for first in range(0, len(t_ns), 26):
        part = slice(first, first + 26)
        odometer.handle(ImuBlock("left", node.gyro[part], node.accel[part], None, 0, t_ns=t_ns[part]))
    odometer.finish()
    error = abs(odometer.distance / drive.length - 1.0)
    if max_error is None:
        assert error > 0.3, "with an assumed range of 2000 deg/s the saturated samples shorten the distance"
    else:
        assert error < max_error, f"seed {SEED}"
