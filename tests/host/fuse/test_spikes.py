"""Accelerations that stand out alone: which are replaced, and that nothing else is."""

from __future__ import annotations

import numpy as np
import pytest

from generators import wheel_drives
from generators.spikes import with_spikes
from hubodo.fuse.spikes import find_spikes, remove_spikes
from hubodo.fuse.wheel_odometry import compute_wheel_odometry
from hubodo.recording import Recording, Table
from hubodo.vehicle import NodeMount, Vehicle
from wheel_runs import short_loop, tables

T = np.arange(0.0, 4.0, 0.01)


@pytest.mark.parametrize(("at", "width"), [(1, 1), (200, 1), (398, 1), (2, 2), (200, 2)])
def test_one_or_two_samples_that_stand_out_are_spikes(at: int, width: int) -> None:
    values = 9.8 * np.cos(25.0 * T) + np.random.default_rng(1).normal(0.0, 0.5, len(T))
    spikes = list(range(at, at + width))
    values[spikes] += 90.0
    assert find_spikes(values).tolist() == spikes


def test_edges_shocks_that_ring_vibration_and_short_records_are_no_spikes() -> None:
    rng = np.random.default_rng(2)
    step = np.where(T < 2.0, 0.0, 30.0)
    ringing = 80.0 * np.exp(-np.abs(T - 2.0) / 0.06) * np.cos(2.0 * np.pi * 40.0 * (T - 2.0)) * (T >= 2.0)
    for values in (step, ringing, rng.normal(0.0, 20.0, len(T))):
        assert not len(find_spikes(values))
    assert not len(find_spikes(np.array([0.0, 0.0, 50.0, 0.0, 0.0])))


def test_a_recording_without_spikes_is_the_same_object_and_others_are_named_with_their_channels() -> None:
    recording = Recording(tables(short_loop(3)))
    assert remove_spikes(recording, ("left", "right")) == (recording, ())
    columns = {name: values.copy() for name, values in recording.nodes["left"].columns.items()}
    columns["ax"][500] += 60.0
    spiked = Recording({**recording.nodes, "left": Table(columns)})
    cleaned, (warning,) = remove_spikes(spiked, ("left", "right"))
    assert warning.startswith(f"left: 1 of {len(columns['ax'])} samples stand out alone in ax")
    assert abs(cleaned.nodes["left"]["ax"][500] - 0.5 * (columns["ax"][499] + columns["ax"][501])) < 0.1
    assert cleaned.nodes["right"] is recording.nodes["right"]


def test_one_value_in_a_hundred_from_the_whole_range_hardly_changes_the_track() -> None:
    drive = wheel_drives.drive(
        wheel_drives.loop(np.random.default_rng(4), 40.0, 5.0), np.random.default_rng(4)
    )
    mounts = {name: NodeMount(name, "left") for name in ("left", "right")}
    vehicle = Vehicle(drive.radius, drive.track, mounts)
    ends = []
    for share in (0.0, 0.01):
        recording = Recording(with_spikes(tables(drive), share, 4))
        odometry = compute_wheel_odometry(recording, vehicle, log="drive.mcap")
        ends.append(odometry.track.x[-1] + 1j * odometry.track.y[-1])
        assert any("at this rate the sigmas are too small" in it for it in odometry.warnings) == (share > 0.0)
    # Left in, the spikes move the end by metres.
    assert abs(ends[1] - ends[0]) < 0.01 * drive.length
