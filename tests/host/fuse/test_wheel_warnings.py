"""What a user is told of a drive, and which wheel is left out: each at the edge of where it is said."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hubodo.fuse.wheel.config import WheelConfig, WheelNode
from hubodo.fuse.wheel.drive_warnings import list_warnings
from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.outage_log import OutageLog
from hubodo.fuse.wheel.records import Pose
from hubodo.fuse.wheel.track import (
    WheelReport,
    WheelRun,
    _mirrored_covariance,
    _path_length,
    _rerun_single_wheel,
    _rerun_without_clock_jump,
    track_from_poses,
)
from hubodo.recording import Table

TURN = 2.0 * math.pi
MOVING, ROCKING, RESTING = (float(still) for still in MotionState)


def said(
    still: Any = (RESTING,) * 50, refused: int = 0, verdict: str = "", windows: int = 1000, **wheel: Any
) -> list[str]:
    """Of a drive of so many windows, with one wheel that did nothing unusual but for what is told."""
    usual = {
        "missing_windows": 0,
        "angle_losses": 0,
        "turned_angle": 50.0,
        "net_angle": 50.0,
        "upright_count": 100,
    }
    usual |= {"upright_sum": 100.0, "clipped_windows": 0, "outlier_windows": 0, "name": "left"}
    core = SimpleNamespace(
        wheels=[SimpleNamespace(**{**usual, **wheel})],
        mounting_check=SimpleNamespace(verdict=verdict),
        outages=OutageLog(seconds=0.1 * wheel.pop("silent", 0)),
        windows=windows,
    )
    made = SimpleNamespace(core=core, refused={"left": refused})
    return list_warnings(made, np.array(still))  # type: ignore[arg-type]


def test_of_a_drive_without_fault_nothing_is_said() -> None:
    assert said() == []


@pytest.mark.parametrize(
    ("still", "words"),
    [
        ([MOVING] * 29 + [RESTING], None),
        ([MOVING] * 30 + [RESTING] * 20, "no rest at the start"),
        ([MOVING] * 29 + [ROCKING] + [MOVING] * 20, "rocked at the start"),
        ([ROCKING] * 30 + [RESTING], None),
    ],
)
def test_a_rest_is_expected_in_the_first_three_seconds(still: list[float], words: str | None) -> None:
    assert [words in line for line in said(still)] == ([True] if words else [])  # type: ignore[operator]


@pytest.mark.parametrize(
    ("told", "not_told", "words"),
    [
        ({"missing_windows": 6}, {"missing_windows": 5}, "not heard for 0.6 s of 100.0 s"),
        ({"missing_windows": 26, "silent": 20}, {"missing_windows": 25, "silent": 20}, "not heard for 2.6 s"),
        ({"missing_windows": 1000}, {"missing_windows": 0}, "the track comes from the other wheel alone"),
        ({"angle_losses": 2}, {"angle_losses": 0}, "reinitialised (2 times)"),
        ({"refused": 3}, {"refused": 0}, "3 samples left out"),
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
def test_what_is_unusual_is_said_from_its_edge_on(
    told: dict[str, Any], not_told: dict[str, Any], words: str
) -> None:
    (line,) = said(**told)
    assert words in line
    assert said(**not_told) == []


def test_a_wheel_that_hardly_turned_is_not_said_to_have_rolled_backwards() -> None:
    assert all("backwards" not in line for line in said(turned_angle=0.9 * TURN, net_angle=-0.9 * TURN))


def test_a_few_windows_of_slip_are_nothing_however_short_the_drive() -> None:
    assert said(outlier_windows=5, windows=20) == []
    assert len(said(outlier_windows=6, windows=20)) == 1


def poses(count: int, t: Any = None) -> Any:
    rng = np.random.default_rng(count)
    times = 0.1 * np.arange(1, count + 1) if t is None else t
    return track_from_poses(
        [
            Pose(at, *rng.standard_normal(5), rng.standard_normal((5, 5)), MotionState(k % 3), 0.5 * k, k)
            for k, at in enumerate(times)
        ]
    )


def test_poses_are_collected_column_by_column() -> None:
    track = poses(4)
    assert track.t == pytest.approx([0.1, 0.2, 0.3, 0.4])
    assert track.motion_state.tolist() == [0.0, 1.0, 2.0, 0.0]
    assert track.nis.tolist() == [0.0, 0.5, 1.0, 1.5] and track.dof.tolist() == [0.0, 1.0, 2.0, 3.0]
    assert track.covariance.shape == (4, 5, 5)
    plain = track.to_track()
    variance = np.einsum("nii->in", track.covariance)
    found = [plain.sigma_x, plain.sigma_y, plain.sigma_heading]
    assert np.array(found) == pytest.approx(np.sqrt(np.maximum(variance, 0.0))[:3])


def test_a_way_is_what_was_rolled_and_over_a_silence_the_chord() -> None:
    track = poses(4, [0.1, 0.2, 5.0, 5.1])
    chord = math.hypot(track.x[2] - track.x[1], track.y[2] - track.y[1])
    assert _path_length(track) == pytest.approx(0.1 * np.abs(track.speed[[0, 1, 3]]).sum() + chord)


def test_a_track_that_may_be_its_mirror_image_may_be_twice_as_far_off() -> None:
    """The other one goes backwards with the same headings: all of place and speed is the other way."""
    track = poses(3)
    off = np.column_stack([track.x, track.y, np.zeros(3), track.speed, np.zeros(3)])
    expected = [p + np.outer(2.0 * d, 2.0 * d) for p, d in zip(track.covariance, off, strict=True)]
    assert _mirrored_covariance(track) == pytest.approx(np.array(expected))


CONFIG = WheelConfig(0.2, 0.6, {"left": WheelNode("left", "left"), "right": WheelNode("right", "left")})


def ran(slips: int = 0, alone: float = 0.0, yaw_rate: float = 0.1, **agreement: Any) -> Any:
    """A run whose wheels disagreed in so many windows."""
    told = {
        "usable_side": alone,
        "other_wheel_steers": False,
        "sides_swapped": False,
        "verdict": "what it is",
        **agreement,
    }
    wheels = [SimpleNamespace(name=name, outlier_windows=0, node=node) for name, node in CONFIG.nodes.items()]
    wheels[1].outlier_windows = slips
    core = SimpleNamespace(wheels=wheels, mounting_check=SimpleNamespace(**told))
    report = WheelReport(0.0, 0.0, 0.0, "", {}, {}, {}, {}, ("before",))
    track = SimpleNamespace(yaw_rate=np.full(3, yaw_rate))
    return WheelRun(track, report, SimpleNamespace(core=core, config=CONFIG))  # type: ignore[arg-type]


def table(gap: float | None = None) -> Table:
    t = np.arange(0.0, 10.0, 0.05)
    if gap is not None:
        t = t[(t < gap + 0.01) | (t > gap + 0.5)]
    return Table(dict.fromkeys(("t", "gx", "gy", "gz", "ax", "ay", "az"), t))


@pytest.mark.parametrize(
    ("slips", "earlier", "alone", "then_alone", "jumped"),
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
def test_a_clock_jumped_where_the_wheels_agree_but_for_what_came_after_a_gap_of_one(
    name: str, slips: int, earlier: int, alone: float, then_alone: float, jumped: bool
) -> None:
    nodes = {"left": table(), "right": table(), name: table(4.0)}
    asked: list[dict[str, Table]] = []

    def again(told: dict[str, Table]) -> Any:
        asked.append(told)
        return ran(earlier, then_alone)

    found = _rerun_without_clock_jump(nodes, ran(slips, alone).filter, again)
    assert (found is not None) == jumped
    for told in asked:
        assert told[name].t[-1] == pytest.approx(4.0)
        other = "right" if name == "left" else "left"
        assert told[other] is nodes[other]
    if found is not None:
        assert f"{name}: its clock jumped at t = 4.0 s" in found.report.warnings[0]
        assert found.report.warnings[1:] == ("before",)


def test_a_gap_of_both_and_no_gap_are_no_clock() -> None:
    for nodes in (
        {"left": table(), "right": table()},
        {"left": table(4.0), "right": table(7.0)},
        {"left": table(4.0), "right": table(4.0)},
        {"left": table(4.0)},
    ):
        assert _rerun_without_clock_jump(nodes, ran(100).filter, lambda _: pytest.fail("ran again")) is None


@pytest.mark.parametrize(
    ("alone", "steering", "exchanged", "runs", "kept"),
    [
        (1.0, False, False, {"left": "left"}, "left"),
        (-1.0, False, False, {"right": "right"}, "right"),
        (1.0, False, True, {"left": "right"}, "left"),
        (-1.0, False, True, {"right": "left"}, "right"),
        (1.0, True, False, {"left": "left", "right": "right"}, "right"),
    ],
)
def test_of_two_wheels_that_are_no_axle_one_is_run_by_itself(
    alone: float, steering: bool, exchanged: bool, runs: dict[str, str], kept: str
) -> None:
    """Of two that turn otherwise the one that turns less; of exchanged ones on the other side."""
    sides = {}

    def again(told: Any, config: WheelConfig) -> Any:
        ((name, node),) = config.nodes.items()
        sides[name] = node.side
        return ran(yaw_rate={"left": -0.3, "right": 0.2}[name])

    made = ran(0, alone, other_wheel_steers=steering, sides_swapped=exchanged).filter
    found = _rerun_single_wheel({}, made, again)
    assert found is not None and sides == runs
    line = found.report.warnings[0]
    assert line.startswith("what it is") and line.endswith(f"the track comes from {kept} alone")
    assert ("left turns more than right" in line) == steering
    assert found.track.yaw_rate[0] == {"left": -0.3, "right": 0.2}[kept]


def test_an_axle_is_run_as_it_is() -> None:
    assert _rerun_single_wheel({}, ran(50).filter, lambda *_: pytest.fail("ran again")) is None
