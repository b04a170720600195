"""Fusion of a recording: its tables, its files, and what it reports without truth."""

import math
from dataclasses import fields

import numpy as np
import pytest

from generators import wheel_drives
from generators.gnss_drives import geodetic
from hubodo.errors import InputError
from hubodo.fuse.fused_recording import (
    TRACK_COLUMNS,
    FusedRecording,
    check_no_results,
    track_to_table,
    write_results,
)
from hubodo.fuse.fusion import SAMPLES_BY_TABLE, fuse_recording, score_against_truth
from hubodo.fuse.track import Track
from hubodo.recording import Recording, Table
from hubodo.vehicle import NodeMount, Vehicle
from wheel_runs import BOTH, tables

T = np.arange(4.0)
TRACK = Track(T, 2.0 * T, 0.0 * T, 0.0 * T, 0.0 * T + 2.0, *np.full((7, 4), 0.1))


def fused_recording(lag=0.0, methods=("wheel filter",)):
    return FusedRecording("log", TRACK, methods, lag, ("left",), {"distance": 6.0}, None, None, ())


def test_sample_tables_are_tables_of_a_recording():
    assert set(SAMPLES_BY_TABLE) <= {item.name for item in fields(Recording)}


def test_track_csv_has_the_promised_columns():
    assert tuple(track_to_table(TRACK)) == TRACK_COLUMNS


def test_without_truth_there_is_no_score():
    assert score_against_truth(TRACK, Recording({})) is None
    truth = Table({"t": T, "x": 2.0 * T, "y": 0.0 * T + 1.0})
    assert score_against_truth(TRACK, Recording({}, truth=truth)).final_error == pytest.approx(0.0)


@pytest.mark.parametrize(
    ("lag", "methods", "smoothing", "causal"),
    [
        (0.0, ("filter",), {"kind": "none"}, True),
        (2.0, ("filter",), {"kind": "fixed lag", "lag": 2.0}, False),
        (math.inf, ("filter",), {"kind": "full"}, False),
        (0.0, ("filter", "graph"), {"kind": "none"}, False),
    ],
)
def test_only_a_filter_without_lag_and_graph_is_causal(lag, methods, smoothing, causal):
    content = fused_recording(lag, methods).as_json()
    assert content["smoothing"] == smoothing and content["causal"] is causal


def test_existing_results_are_not_overwritten(tmp_path):
    check_no_results(tmp_path / "out")
    write_results(fused_recording(), tmp_path / "out")
    with pytest.raises(InputError, match=r"track\.csv: exists"):
        check_no_results(tmp_path / "out")


@pytest.mark.parametrize(("factor", "is_named"), [(1.1, True), (1.0, False)])
def test_a_radius_that_fixes_contradict_is_named_with_its_value(factor, is_named):
    """A nominal radius is known to 2.5 %; fixes of 0.2 m over 60 m show one that is 10 % off."""
    rng = np.random.default_rng(105)
    drive = wheel_drives.drive(wheel_drives.loop(rng, 60.0, 4.0), rng)
    t = np.arange(1.0, drive.t[-1] - 1.0, 0.5)
    position = [
        np.interp(t, drive.t, value) + 0.2 * rng.standard_normal(len(t)) for value in (drive.x, drive.y)
    ]
    latitude, longitude = geodetic(*position, 47.37, 8.54)
    gnss = Table(
        {"t": t, "latitude_deg": latitude, "longitude_deg": longitude, "sigma": np.full(len(t), 0.2)}
    )
    mounts = {side: NodeMount(side, "left") for side in BOTH}
    vehicle = Vehicle(factor * drive.radius, drive.track, mounts)
    fused = fuse_recording(Recording(tables(drive), gnss=gnss), vehicle, log="log")
    named = [line for line in fused.warnings if "show a wheel radius of" in line]
    assert bool(named) is is_named, fused.warnings
    if is_named:
        shown = float(named[0].split("wheel radius of ")[1].split(" m")[0])
        assert shown == pytest.approx(drive.radius, rel=0.02)
