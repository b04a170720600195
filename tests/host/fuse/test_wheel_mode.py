"""Mode of a wheel: every combination of its inputs, and the measurements that each mode allows."""

from __future__ import annotations

import pytest

from hubodo.fuse.wheel.measurements import (
    MEASUREMENTS,
    Measurement,
    forward,
    roll,
    rolling,
    sideways,
    yaw,
)
from hubodo.fuse.wheel.wheel import WheelMode, select_mode, usage_by_mode

ROLLING, DISTRUSTED, SLIPPING, UNKNOWN, LOST, OUTAGE, DISABLED = WheelMode


@pytest.mark.parametrize(
    ("best_mode", "angle_known", "is_slipping", "mode"),
    [
        (ROLLING, True, False, ROLLING),
        (ROLLING, True, True, SLIPPING),
        (ROLLING, False, False, UNKNOWN),
        (ROLLING, False, True, LOST),
        (DISTRUSTED, True, False, DISTRUSTED),
        (DISTRUSTED, True, True, SLIPPING),
        (DISTRUSTED, False, False, LOST),
        (DISTRUSTED, False, True, LOST),
        (DISABLED, True, False, DISABLED),
        (DISABLED, False, True, DISABLED),
    ],
)
def test_mode_for_every_combination_of_inputs(
    best_mode: WheelMode, angle_known: bool, is_slipping: bool, mode: WheelMode
) -> None:
    assert select_mode(best_mode, angle_known, is_slipping, 0.49) is mode
    assert select_mode(best_mode, angle_known, is_slipping, 0.5) is (
        DISABLED if best_mode is DISABLED else OUTAGE
    )


@pytest.mark.parametrize(
    ("mode", "used"),
    [
        (ROLLING, {yaw, roll, forward, sideways, rolling}),
        (DISTRUSTED, {yaw, roll, forward, sideways}),
        (SLIPPING, {yaw, roll}),
        (UNKNOWN, {rolling}),
        (LOST, set()),
        (OUTAGE, set()),
        (DISABLED, set()),
    ],
)
def test_each_mode_uses_its_measurements(mode: WheelMode, used: set[object]) -> None:
    listed: tuple[Measurement, ...] = (yaw, roll, forward, sideways, rolling)
    usage = dict(zip(MEASUREMENTS, usage_by_mode(MEASUREMENTS)[mode], strict=True))
    assert {measurement for measurement in listed if usage[measurement]} == used
    assert mode.knows_angle == (yaw in used)
