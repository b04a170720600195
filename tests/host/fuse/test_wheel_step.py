"""Steps of the wheel filter: turned angles, mounting verdicts and tilt correction, in any order of nodes."""

import numpy as np
import pytest

from generators import wheel_drives
from hubodo.fuse.wheel.axle_rate import remove_tilt_rate
from hubodo.fuse.wheel.entries import MISALIGNMENT_X, MISALIGNMENT_Y
from hubodo.fuse.wheel.filter import WheelFilter
from hubodo.fuse.wheel.filter_core import FilterCore
from hubodo.fuse.wheel.track import run_wheel_filter
from hubodo.fuse.wheel.wheel import WheelMode
from hubodo.fuse.wheel.window import WINDOW_S, Window
from wheel_runs import BOTH, config, sample_columns, short_loop, tables


def _core_after_drive(drive: wheel_drives.WheelDrive) -> FilterCore:
    """Return the core of a wheel filter after a whole drive."""
    wheel_filter = WheelFilter(config(drive))
    wheel_filter.handle_blocks(sample_columns(drive))
    wheel_filter.finish()
    return wheel_filter.core


def test_the_mean_turned_angle_of_both_wheels_is_the_distance_driven() -> None:
    """The difference of the wheels on a loop cancels in their mean; radii deviate from the declared ones."""
    drive = short_loop(21)
    wheels = _core_after_drive(drive).wheels
    distances = drive.radius * np.mean(
        [[it.counts.turned_angle, it.counts.net_angle] for it in wheels], axis=0
    )
    assert distances == pytest.approx([drive.length, drive.length], rel=0.02)


@pytest.mark.parametrize("order", [BOTH, BOTH[::-1]])
@pytest.mark.parametrize("reversed_node", [None, *BOTH])
def test_a_reversed_node_is_named_in_any_order_of_nodes(
    order: tuple[str, str], reversed_node: str | None
) -> None:
    drive = short_loop(22, facing={reversed_node: "right"} if reversed_node else {})
    warnings = [
        line
        for line in run_wheel_filter(config(drive, order), tables(drive)).report.warnings
        if "mounted" in line
    ]
    assert len(warnings) == (reversed_node is not None)
    assert all(f"on the {reversed_node} wheel" in line for line in warnings)


def test_with_swapped_sides_one_wheel_continues_on_its_true_side() -> None:
    drive = short_loop(22)
    wheel_filter, nodes = WheelFilter(config(drive)), drive.nodes
    recorded = {"left": nodes["right"], "right": nodes["left"]}
    wheel_filter.handle_blocks({name: (node.t, node.gyro, node.accel) for name, node in recorded.items()})
    wheel_filter.finish()
    declared, trusted = (
        {
            wheel.name: wheel.geometry.contact_y
            for wheel in core.wheels
            if wheel.best_mode is WheelMode.ROLLING
        }
        for core in (_core_after_drive(drive), wheel_filter.core)
    )
    assert len(declared) == 2
    assert len(trusted) == 1
    assert all(trusted[name] == -declared[name] for name in trusted)


def test_the_rate_that_leaks_through_a_tilt_is_removed_from_the_spin() -> None:
    rng = np.random.default_rng(8)
    core = FilterCore(config(short_loop(1)))
    wheel = core.wheels[0]
    for _ in range(20):
        tilt, rate = 0.02 * rng.standard_normal(2), rng.standard_normal(3)
        core.x[wheel.columns[MISALIGNMENT_X]], core.x[wheel.columns[MISALIGNMENT_Y]] = tilt
        measured = (rate - np.cross([*tilt, 0.0], rate)) * WINDOW_S
        window = Window(spin=measured[2], raw_across=complex(measured[0], measured[1]))
        spin = remove_tilt_rate(core.x, wheel.columns, window).spin
        # The correction is of first order in the tilt.
        assert (
            abs(spin - rate[2] * WINDOW_S) < 2.0 * np.linalg.norm(tilt) ** 2 * np.linalg.norm(rate) * WINDOW_S
        )
