"""A real ride on two wheels through chip registers, firmware, pseudo serial ports, recorder, log, fusion."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from wheelchair_ride import ODR_ERROR, RIDE, START, WHEELS, Ride, drive, read_csv

import wanted
from hubodo.cli import main
from hubodo.flash.image import build_image, firmware_folder
from hubowire.messages import node_name
from virtual_runs import micropython_or_skip


@pytest.fixture(scope="module")
def ride(tmp_path_factory) -> Ride:
    micropython_or_skip()
    return drive(wanted.recording("wheelchair"), tmp_path_factory.mktemp("ride"))


def exported(ride: Ride) -> Path:
    out = ride.folder / "csv"
    if not out.exists():
        assert main(["export", str(ride.folder / "ride.mcap"), "-o", str(out)]) == 0
    return out


def test_node_names_are_those_of_the_table():
    assert {node_name(number): number for number in WHEELS.values()} == WHEELS


def test_no_sample_is_lost_between_the_chips_and_the_log(ride):
    for name in WHEELS:
        node_result = ride.result["nodes"][name]
        assert (node_result["samples_lost"], node_result["frames_lost"], node_result["gaps"]) == (0, 0, {}), (
            node_result
        )
        assert ride.stats[name]["fifo_dropped"] == 0


def steps(ride: Ride, name: str) -> tuple[np.ndarray, np.ndarray, int]:
    """Return times (N,) s, raw values (N, 6) of exported samples, and their index in the chip's record."""
    table = read_csv(exported(ride) / f"{name}.csv")
    gyro = np.column_stack([table[c] for c in ("gx", "gy", "gz")]) / np.deg2rad(0.070)
    accel = np.column_stack([table[c] for c in ("ax", "ay", "az")]) / (0.000488 * 9.80665)
    values = np.column_stack([gyro, accel])
    raw = np.rint(values).astype(np.int64)
    np.testing.assert_allclose(values, raw, atol=1e-6)
    # The node discards samples from before its FIFO was enabled. At the start of the ride all
    # samples differ, so that only one position matches.
    truth = ride.truth[name]
    middle = len(raw) // 2
    first = next(
        k for k in range(len(truth.raw) - len(raw) + 1)
        if np.array_equal(truth.raw[k + middle : k + middle + 50], raw[middle : middle + 50])
    )  # fmt: skip
    return table["t"], raw, first


@pytest.mark.parametrize("name", WHEELS)
def test_every_exported_sample_equals_the_raw_value_of_the_chip(ride, name):
    """Raw integers recovered from the CSV equal the chip's own for the complete ride, in order."""
    t, raw, first = steps(ride, name)
    truth = ride.truth[name]
    np.testing.assert_array_equal(raw, truth.raw[first : first + len(raw)])
    covered = truth.t[first : first + len(raw)]
    assert covered[0] < START
    assert covered[-1] > START + RIDE
    rate = 416.0 * (1 + ODR_ERROR[name])
    assert np.median(np.diff(t)) == pytest.approx(1 / rate, rel=2e-3)


def test_fusion_gives_the_path_length_of_the_wheel_speeds(ride):
    """Compared with the integral of the recording's own wheel speeds over the ride."""
    log, vehicle, out = (str(ride.folder / name) for name in ("ride.mcap", "vehicle.toml", "fused"))
    assert main(["fuse", log, "--vehicle", vehicle, "-o", out]) == 0
    track = read_csv(ride.folder / "fused" / "track.csv")
    assert list(track)[:5] == ["t", "x", "y", "heading", "speed"]
    assert (track["x"][0], track["y"][0], track["heading"][0]) == (0, 0, 0)

    data = wanted.recording("wheelchair")
    wheels = [read_csv(data / f"{name}.csv.gz") for name in WHEELS]
    grid = np.linspace(0.0, RIDE, 15001)
    speeds = [0.31 * np.interp(grid, wheel["t"], wheel["gz"]) for wheel in wheels]
    plain = np.trapezoid(np.abs(np.mean(speeds, axis=0)), grid)

    t, raw, first = steps(ride, "left")
    chip_t = ride.truth["left"].t[first : first + len(raw)]
    # The wheelchair moves at the end, so the path is interpolated between the poses of 10 Hz.
    path = np.append(0.0, np.cumsum(np.hypot(np.diff(track["x"]), np.diff(track["y"]))))
    start, end = np.interp(np.interp([START, START + RIDE], chip_t, t), track["t"], path)
    assert end - start == pytest.approx(plain, rel=0.01)


def test_the_firmware_that_ran_is_the_image_that_is_flashed(ride):
    """The files on the virtual board equal those that `hubodo flash` would copy, byte by byte."""
    image = build_image(firmware_folder(), None)
    for name, content in image.items():
        assert (ride.folder / "image" / name).read_bytes() == content
    shutil.rmtree(ride.folder / "image")
