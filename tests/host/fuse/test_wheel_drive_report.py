"""Warnings of a drive, and which wheel is excluded: each at its threshold."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hubodo.fuse.wheel.config import WheelConfig, WheelNode
from hubodo.fuse.wheel.drive_report import WheelReport, _path_length, list_warnings
from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.outage_log import OutageLog
from hubodo.fuse.wheel.records import Pose
from hubodo.fuse.wheel.track import (
    WheelRun,
    _mirrored_covariance,
    _rerun_single_wheel,
    _rerun_without_clock_jump,
    track_from_poses,
)
from hubodo.fuse.wheel.wheel_counts import WheelCounts
from hubodo.recording import Table

TURN = 2.0 * math.pi
MOVING, ROCKING, STANDSTILL = (float(state) for state in MotionState)


def warnings_of(
    motion_states: Any = (STANDSTILL,) * 50,
    refused: int = 0,
    glitches: int = 0,
    verdict: str = "",
    windows: int = 1000,
    ground_rate_sigma: float = 0.0,
    **changes: Any,
) -> list[str]:
    """Return the warnings of a drive of that many windows with one wheel; changes: its unusual values."""
    outages = OutageLog(seconds=0.1 * changes.pop("outage_windows", 0))
    usual = {"turned_angle": 50.0, "net_angle": 50.0, "upright_count": 100, "upright_sum": 100.0}
    core = SimpleNamespace(
        wheels=[SimpleNamespace(name="left", counts=WheelCounts(**{**usual, **changes}))],
        mounting_check=SimpleNamespace(verdict=verdict),
        outages=outages,
        windows=windows,
    )
    config = SimpleNamespace(ground_rate_sigma=ground_rate_sigma)
    counts = {"rejected_samples": {"left": refused + glitches}, "glitches": {"left": glitches}}
    wheel_filter = SimpleNamespace(core=core, config=config, **counts)
    return list_warnings(wheel_filter, np.array(motion_states))  # type: ignore[arg-type]


def test_a_drive_without_fault_has_no_warnings() -> None:
    assert warnings_of() == []


@pytest.mark.parametrize("windows", [2072, 2074])
def test_the_rotation_of_the_earth_is_reported_from_half_a_degree_on(windows: int) -> None:
    """The sine of an unknown latitude has an rms of 1/√3: half a degree in 207.3 s."""
    lines = warnings_of(windows=windows, ground_rate_sigma=7.2921159e-5 / math.sqrt(3.0))
    assert [line for line in lines if "latitude_deg" in line] == lines
    assert len(lines) == (windows == 2074)


@pytest.mark.parametrize(
    ("motion_states", "text"),
    [
        ([MOVING] * 29 + [STANDSTILL], None),
        ([MOVING] * 30 + [STANDSTILL] * 20, "no rest at the start"),
        ([MOVING] * 29 + [ROCKING] + [MOVING] * 20, "rocked at the start"),
        ([ROCKING] * 30 + [STANDSTILL], None),
    ],
)
def test_a_standstill_is_expected_in_the_first_three_seconds(
    motion_states: list[float], text: str | None
) -> None:
    assert [text in line for line in warnings_of(motion_states)] == ([True] if text else [])  # type: ignore[operator]


@pytest.mark.parametrize(
    ("beyond", "within", "text"),
    [
        ({"missing_windows": 6}, {"missing_windows": 5}, "not heard for 0.6 s of 100.0 s"),
        (
            {"missing_windows": 26, "outage_windows": 20},
            {"missing_windows": 25, "outage_windows": 20},
            "not heard for 2.6 s",
        ),
        ({"missing_windows": 1000}, {"missing_windows": 0}, "the track comes from the other wheel alone"),
        ({"angle_losses": 2}, {"angle_losses": 0}, "reinitialised (2 times)"),
        ({"refused": 3}, {"refused": 0}, "3 samples left out because their time"),
        ({"glitches": 3}, {"glitches": 0}, "3 samples left out because their rate jumps"),
        ({"turned_angle": 0.99 * TURN}, {"turned_angle": 1.01 * TURN}, "turned only 0.99 times"),
        ({"net_angle": -40.1}, {"net_angle": -39.9}, "rolled backwards"),
        ({"upright_sum": 49.0}, {"upright_sum": 51.0}, "gravity does not turn"),
        (
            {"upright_count": 50, "upright_sum": 24.0},
            {"upright_count": 49, "upright_sum": 24.0},
            "gravity does not turn",
        ),
        ({"clipped_windows": 7}, {"clipped_windows": 0}, "gz at its limit for 0.7 s"),
        ({"outlier_windows": 51}, {"outlier_windows": 50}, "disagreed with the other wheel for 5.1 s"),
        ({"verdict": "they are exchanged"}, {"verdict": ""}, "they are exchanged"),
    ],
)
def test_each_warning_starts_at_its_threshold(
    beyond: dict[str, Any], within: dict[str, Any], text: str
) -> None:
    (line,) = warnings_of(**beyond)
    assert text in line
    assert warnings_of(**within) == []


def test_a_wheel_that_hardly_turned_has_no_warning_of_rolling_backwards() -> None:
    assert all(
        "backwards" not in line for line in warnings_of(turned_angle=0.9 * TURN, net_angle=-0.9 * TURN)
    )


def test_up_to_five_outlier_windows_give_no_warning_on_a_short_drive() -> None:
    assert warnings_of(outlier_windows=5, windows=20) == []
    assert len(warnings_of(outlier_windows=6, windows=20)) == 1


def random_track(count: int, t: Any = None) -> Any:
    """Return a track of `count` random poses at times t, s, by default every 0.1 s."""
    rng = np.random.default_rng(count)
    times = 0.1 * np.arange(1, count + 1) if t is None else t
    return track_from_poses(
        [
            Pose(stamp, *rng.standard_normal(5), rng.standard_normal((5, 5)), MotionState(k % 3), 0.5 * k, k)
            for k, stamp in enumerate(times)
        ]
    )


def test_a_track_contains_the_poses_as_columns() -> None:
    track = random_track(4)
    assert track.t == pytest.approx([0.1, 0.2, 0.3, 0.4])
    assert track.motion_state.tolist() == [0.0, 1.0, 2.0, 0.0]
    assert track.nis.tolist() == [0.0, 0.5, 1.0, 1.5] and track.dof.tolist() == [0.0, 1.0, 2.0, 3.0]
    assert track.covariance.shape == (4, 5, 5)
    variance = np.einsum("nii->in", track.covariance)
    sigmas = [track.sigma_x, track.sigma_y, track.sigma_heading]
    assert np.array(sigmas) == pytest.approx(np.sqrt(np.maximum(variance, 0.0))[:3])


def test_the_path_length_is_the_rolled_distance_and_across_an_outage_the_chord() -> None:
    track = random_track(4, [0.1, 0.2, 5.0, 5.1])
    chord = math.hypot(track.x[2] - track.x[1], track.y[2] - track.y[1])
    assert _path_length(track) == pytest.approx(0.1 * np.abs(track.speed[[0, 1, 3]]).sum() + chord)


def test_the_covariance_of_a_possibly_mirrored_track_covers_both_tracks() -> None:
    """The other track runs backwards with the same headings: position and speed change sign."""
    track = random_track(3)
    deviations = np.column_stack([track.x, track.y, np.zeros(3), track.speed, np.zeros(3)])
    expected = [p + np.outer(2.0 * d, 2.0 * d) for p, d in zip(track.covariance, deviations, strict=True)]
    assert _mirrored_covariance(track) == pytest.approx(np.array(expected))


CONFIG = WheelConfig(0.2, 0.6, {"left": WheelNode("left", "left"), "right": WheelNode("right", "left")})


def make_run(
    outlier_windows: int = 0, usable_side: float = 0.0, yaw_rate: float = 0.1, **changes: Any
) -> Any:
    """Return a run whose wheels disagreed in that many windows; changes: fields of the mounting check."""
    mounting = {
        "usable_side": usable_side,
        "other_wheel_steers": False,
        "sides_swapped": False,
        "verdict": "what it is",
        **changes,
    }
    wheels = [
        SimpleNamespace(name=name, counts=WheelCounts(), node=node) for name, node in CONFIG.nodes.items()
    ]
    wheels[1].counts.outlier_windows = outlier_windows
    core = SimpleNamespace(wheels=wheels, mounting_check=SimpleNamespace(**mounting))
    report = WheelReport(0.0, 0.0, 0.0, "", {}, {}, {}, {}, ("before",))
    track = SimpleNamespace(yaw_rate=np.full(3, yaw_rate))
    return WheelRun(track, report, SimpleNamespace(core=core, config=CONFIG))  # type: ignore[arg-type]


def node_table(gap: float | None = None) -> Table:
    t = np.arange(0.0, 10.0, 0.05)
    if gap is not None:
        t = t[(t < gap + 0.01) | (t > gap + 0.5)]
    return Table(dict.fromkeys(("t", "gx", "gy", "gz", "ax", "ay", "az"), t))


@pytest.mark.parametrize(
    ("outlier_windows", "outliers_before_gap", "usable_side", "usable_side_before_gap", "jumped"),
    [
        (10, 0, 0.0, 0.0, True),
        (9, 0, 0.0, 0.0, False),
        (13, 2, 0.0, 0.0, False),
        (14, 2, 0.0, 0.0, True),
        (0, 0, 1.0, 0.0, True),
        (0, 0, -1.0, 0.0, True),
        (0, 0, 1.0, 1.0, False),
        (10, 0, 1.0, 1.0, True),
    ],
)
@pytest.mark.parametrize("name", ["left", "right"])
def test_a_clock_jump_is_assumed_if_the_wheels_agree_up_to_a_gap_of_one_node(
    name: str,
    outlier_windows: int,
    outliers_before_gap: int,
    usable_side: float,
    usable_side_before_gap: float,
    jumped: bool,
) -> None:
    nodes = {"left": node_table(), "right": node_table(), name: node_table(4.0)}
    calls: list[dict[str, Table]] = []

    def rerun(tables: dict[str, Table]) -> Any:
        calls.append(tables)
        return make_run(outliers_before_gap, usable_side_before_gap)

    result = _rerun_without_clock_jump(nodes, make_run(outlier_windows, usable_side).filter, rerun)
    assert (result is not None) == jumped
    for tables in calls:
        assert tables[name].t[-1] == pytest.approx(4.0)
        other = "right" if name == "left" else "left"
        assert tables[other] is nodes[other]
    if result is not None:
        assert f"{name}: its clock jumped at t = 4.0 s" in result.report.warnings[0]
        assert result.report.warnings[1:] == ("before",)


def test_without_a_gap_of_a_single_node_no_clock_jump_is_assumed() -> None:
    for nodes in (
        {"left": node_table(), "right": node_table()},
        {"left": node_table(4.0), "right": node_table(7.0)},
        {"left": node_table(4.0), "right": node_table(4.0)},
        {"left": node_table(4.0)},
    ):
        assert (
            _rerun_without_clock_jump(nodes, make_run(100).filter, lambda _: pytest.fail("ran again")) is None
        )


@pytest.mark.parametrize(
    ("usable_side", "steering", "swapped", "expected_sides", "selected"),
    [
        (1.0, False, False, {"left": "left"}, "left"),
        (-1.0, False, False, {"right": "right"}, "right"),
        (1.0, False, True, {"left": "right"}, "left"),
        (-1.0, False, True, {"right": "left"}, "right"),
        (1.0, True, False, {"left": "left", "right": "right"}, "right"),
    ],
)
def test_two_wheels_that_are_not_an_axle_give_a_rerun_with_one_wheel(
    usable_side: float, steering: bool, swapped: bool, expected_sides: dict[str, str], selected: str
) -> None:
    """If one steers, the wheel that turns less is used; with swapped sides the wheel changes its side."""
    sides = {}

    def rerun(tables: Any, config: WheelConfig) -> Any:
        ((name, node),) = config.nodes.items()
        sides[name] = node.side
        return make_run(yaw_rate={"left": -0.3, "right": 0.2}[name])

    wheel_filter = make_run(0, usable_side, other_wheel_steers=steering, sides_swapped=swapped).filter
    result = _rerun_single_wheel({}, wheel_filter, rerun)
    assert result is not None and sides == expected_sides
    line = result.report.warnings[0]
    assert line.startswith("what it is") and line.endswith(f"the track comes from {selected} alone")
    assert ("left turns more than right" in line) == steering
    assert result.track.yaw_rate[0] == {"left": -0.3, "right": 0.2}[selected]


def test_an_axle_is_not_rerun() -> None:
    assert _rerun_single_wheel({}, make_run(50).filter, lambda *_: pytest.fail("ran again")) is None
