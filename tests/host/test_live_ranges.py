"""The odometer of a recording takes the ranges that a node tells when it begins."""

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
    ("told", "worst"), [({"gyro_range_dps": "500", "accel_range_g": "16"}, 0.01), ({}, None)]
)
def test_the_way_is_whole_where_the_node_tells_its_range(told: dict[str, str], worst: float | None) -> None:
    drive = clipped_drive(CASE, SEED)
    node, odometer = drive.nodes["left"], Odometer(VEHICLE, 0, rate_hz=10.0)
    odometer.update_ranges("left", told)
    odometer.update_ranges("frame", told)
    t_ns = np.round(node.t * 1e9).astype(np.int64)
    for first in range(0, len(t_ns), 26):
        part = slice(first, first + 26)
        odometer.handle(ImuBlock("left", node.gyro[part], node.accel[part], None, 0, t_ns=t_ns[part]))
    odometer.finish()
    off = abs(odometer.distance / drive.length - 1.0)
    if worst is None:
        assert off > 0.3, "a node that is taken for one of 2000 deg/s loses what it could not say"
    else:
        assert off < worst, f"seed {SEED}"
