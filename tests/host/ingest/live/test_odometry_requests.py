"""Poses set by other programs during a recording, and bias initialisation of all nodes."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from fakes.fake_node import FakeNode
from fakes.script import Script
from generators.fake_drive import raw_rows, short_drive
from hubodo.arrays import Array
from hubodo.ingest.live.daemon import record
from hubodo.ingest.live.odometry_requests import FindBias, SetPose
from hubodo.ingest.live.record_config import RecordConfig
from hubodo.ingest.live.virtual_computer import VirtualComputer
from hubodo.ingest.replay.playback import Playback, recorded_messages, to_messages
from hubodo.log.recording_reader import read_recording
from hubodo.recording import Recording
from set_pose_runs import VEHICLE, pose_nees

COVARIANCE = np.array([[0.04, 0.01, 0.002], [0.01, 0.09, 0.0], [0.002, 0.0, 0.01]])


@dataclass
class Ride:
    """A recording in which poses are set at 4 s and 6 s; outcomes of the requests in their order."""

    path: Path
    outcomes: list[tuple[bool, str]] = field(default_factory=list)
    set_at_ns: list[int] = field(default_factory=list)

    def log(self) -> Recording:
        return read_recording(self.path)


@pytest.fixture(scope="module")
def ride(tmp_path_factory: pytest.TempPathFactory) -> Ride:
    folder, drive, computer = tmp_path_factory.mktemp("ride"), short_drive(5), VirtualComputer()
    result = Ride(folder / "ride.mcap")

    def note(success: bool, text: str) -> None:
        result.outcomes.append((success, text))

    def set_pose(x: float, covariance: Array, refusal: str = "") -> None:
        result.set_at_ns.append(computer.now_ns())
        computer.put(SetPose(computer.now_ns(), "dock", x, -5.0, 2.0, covariance, note, refusal))

    Script(
        computer,
        (4.0, lambda: set_pose(10.0, COVARIANCE)),
        (5.0, lambda: set_pose(20.0, -COVARIANCE)),
        (5.1, lambda: set_pose(20.0, COVARIANCE, "frame 'map'")),
        (6.0, lambda: set_pose(0.0, np.zeros((3, 3)))),
        (6.5, lambda: computer.put(FindBias(computer.now_ns(), "dock", note))),
    )
    ports = [f"{name}={folder / name}" for name in ("left", "right")]
    with (
        FakeNode(node_id=1, link=folder / "left", rows=raw_rows(drive, "left"), computer=computer),
        FakeNode(node_id=2, link=folder / "right", rows=raw_rows(drive, "right"), computer=computer),
    ):
        record(
            RecordConfig(ports=tuple(ports), duration=7.0), result.path, vehicle=VEHICLE, computer=computer
        )
    return result


def rows_at(ride: Ride, number: int) -> tuple[Recording, int]:
    """Return the log, and the row of /odom just after request `number`."""
    log = ride.log()
    after = np.searchsorted(log.odometry["t"], (ride.set_at_ns[number] - log.t_zero_ns) * 1e-9)
    return log, int(after) + 1


def test_the_pose_jumps_to_the_one_that_was_set_and_moves_on_with_the_vehicle(ride: Ride) -> None:
    log, row = rows_at(ride, 0)
    odometry = log.odometry
    pose = [odometry[name][row] for name in ("x", "y", "heading")]
    assert pose == pytest.approx([10.0, -5.0, 2.0], abs=0.06)  # 50 ms later
    assert abs(odometry["x"][row - 20]) < 3.0
    # 1 s at 1.2 m/s in the direction of the heading that was set.
    step = complex(
        odometry["x"][row + 208] - odometry["x"][row], odometry["y"][row + 208] - odometry["y"][row]
    )
    assert abs(step) == pytest.approx(1.2, rel=0.05)
    assert np.angle(step) == pytest.approx(0.5 * (odometry["heading"][row + 208] + 2.0), abs=0.02)


def test_the_covariance_starts_at_the_one_that_was_set_and_grows(ride: Ride) -> None:
    _, row = rows_at(ride, 0)
    blocks = Playback(ride.path, vehicle=VEHICLE).odometry_rows()
    sigmas = np.sqrt(
        np.diagonal(np.concatenate([block.pose_covariance for block in blocks]), axis1=1, axis2=2)
    )
    assert sigmas[row] == pytest.approx(np.sqrt(np.diag(COVARIANCE)), rel=0.03)
    # The heading error of 0.1 rad displaces it sideways by a tenth of the distance.
    assert sigmas[row + 208] @ sigmas[row + 208] > 1.05 * sigmas[row] @ sigmas[row]
    _, reset = rows_at(ride, 3)
    assert np.all(sigmas[reset] < 0.01)


def test_poses_are_refused_for_their_frame_or_covariance_and_change_nothing(ride: Ride) -> None:
    outcomes = ride.outcomes[1:3]
    assert [success for success, _ in outcomes] == [False, False]
    assert "dock: pose refused: the covariance" in outcomes[0][1] and "frame 'map'" in outcomes[1][1]
    log, row = rows_at(ride, 1)
    assert abs(log.odometry["x"][row + 1] - log.odometry["x"][row - 1]) < 0.05
    assert [event.text for event in log.events if event.kind == "pose"] == [
        "pose set to 10.000 m, -5.000 m, 114.6° by dock",
        "pose set to 0.000 m, -5.000 m, 114.6° by dock",
    ]


def test_all_nodes_initialise_their_bias_and_their_answers_are_one_outcome(ride: Ride) -> None:
    assert ride.outcomes[-1] == (True, "left: done; right: done")


def test_playback_repeats_the_poses_bit_by_bit(ride: Ride) -> None:
    playback = Playback(ride.path, vehicle=VEHICLE)
    assert to_messages(playback.odometry_rows(), playback.t_zero_ns) == recorded_messages(ride.path)


def test_the_pose_stays_consistent_after_it_was_set() -> None:
    """Five drives, seeds 700..704, errors drawn from the priors; `make accuracy` has sixty others."""
    values = [pose_nees(seed) for seed in range(700, 705)]
    low, high = chi2.ppf([0.005, 0.995], 3 * len(values))
    assert low < sum(values) < high, values
