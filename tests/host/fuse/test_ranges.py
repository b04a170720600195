"""Clipping ranges of a node: from the vehicle file, the node or its samples, with warnings."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from generators.clipped_drives import CASES, clipped_drive
from generators.wheel_drives import GRAVITY, drive, legs
from hubodo.cli import main
from hubodo.errors import ConfigError
from hubodo.fuse.ranges import determine_ranges, node_metadata
from hubodo.log.recording_writer import write_recording
from hubodo.recording import Recording, Table
from hubodo.vehicle import NodeMount, load_vehicle
from vehicles import vehicle_toml
from wheel_runs import tables

SEED = 100
COLUMNS = ("t", "gx", "gy", "gz", "ax", "ay", "az")
SLOW = CASES["500 °/s at 4 m/s"]
DECLARED = {"gyro_range_dps": "500", "accel_range_g": "4"}


def vehicle_file(imu: str, left: str = "") -> str:
    """Return a vehicle file with a line in [imu] and one of the left node."""
    return vehicle_toml(0.15, 0.5, imu=f"{imu}\n", facing={"right": "left", "left": "left"}) + left


@pytest.fixture(scope="module")
def samples() -> dict[str, Table]:
    """Return the tables of a drive whose gyros clip at 500 deg/s."""
    return tables(clipped_drive(SLOW, SEED))


def test_the_range_of_the_vehicle_file_precedes_that_of_the_node_and_the_default() -> None:
    default = determine_ranges(NodeMount("left", "left"), {})
    reported = determine_ranges(NodeMount("left", "left"), DECLARED)
    given = determine_ranges(NodeMount("left", "left", 20.0, 70.0), DECLARED)
    assert (default.gyro.value, default.accel.value) == pytest.approx((math.radians(2000.0), 16.0 * GRAVITY))
    assert (reported.gyro.value, reported.accel.value) == pytest.approx((math.radians(500.0), 4.0 * GRAVITY))
    assert (given.gyro.value, given.accel.value) == (20.0, 70.0)
    assert [r.gyro.source for r in (default, reported, given)] == [
        "default",
        "node",
        "vehicle file",
    ]
    assert 0.95 * 20.0 < given.clipping_limits["gyro_limit"] < 20.0


def test_repeated_maxima_determine_the_range(samples: dict[str, Table]) -> None:
    result = determine_ranges(NodeMount(), {}, samples["left"])
    assert result.gyro.value == pytest.approx(math.radians(500.0), rel=1e-3)
    assert "samples" in result.gyro.source
    assert not result.warnings, "no other range is declared"
    reported = determine_ranges(NodeMount(), {"gyro_range_dps": "2000"}, samples["left"])
    assert reported.gyro.value == result.gyro.value
    assert "clip at" in reported.warnings[0]


def test_without_repeated_maxima_no_clipping_is_detected() -> None:
    rng = np.random.default_rng(SEED)
    unclipped = drive(legs([(6.0, 0.0, 0.0), (10.0, 3.0, 0.1), (3.0, 0.0, 0.0)]), rng)
    for table in tables(unclipped).values():
        assert "default" in determine_ranges(NodeMount(), {}, table).gyro.source
        too_small = determine_ranges(NodeMount(), {"gyro_range_dps": "500"}, table)
        assert too_small.gyro.value > np.abs(table.gyro).max()
        assert "beyond" in too_small.warnings[0]


def test_the_range_of_a_node_precedes_that_of_all_nodes(tmp_path: Path) -> None:
    path = tmp_path / "vehicle.toml"
    path.write_text(vehicle_file("gyro_range = 8.7\naccel_range = 39", "gyro_range = 17.4"))
    nodes = load_vehicle(path).nodes
    assert (nodes["left"].gyro_range, nodes["left"].accel_range) == (17.4, 39.0)
    assert (nodes["right"].gyro_range, nodes["right"].accel_range) == (8.7, 39.0)
    for invalid in ("gyro_range = 0", 'gyro_range = "2000"', "gyro_range = nan"):
        path.write_text(vehicle_file(invalid))
        with pytest.raises(ConfigError, match="gyro_range"):
            load_vehicle(path)


def test_fuse_reports_the_range_and_its_source(samples: dict[str, Table], tmp_path: Path, capsys) -> None:
    """The distance was wrong by 34 % with a small sigma when the range was ignored.

    The range comes from the node on the whole drive, from the file and from samples of one node on its first
    34 s, of which 8 s are beyond the range.
    """
    length = clipped_drive(SLOW, SEED).length
    left = samples["left"]
    first_samples = {"left": Table({key: left[key][left.t < 34.0] for key in COLUMNS})}
    reported = {f"node.{name}.{key}": text for name in samples for key, text in DECLARED.items()}
    assert node_metadata(reported, "left") == DECLARED
    for number, (imu, metadata, source) in enumerate(
        [("", reported, "node"), ("gyro_range = 8.72665", {}, "vehicle file"), ("", {}, "samples")]
    ):
        folder = tmp_path / str(number)
        folder.mkdir()
        (folder / "vehicle.toml").write_text(vehicle_file(imu))
        write_recording(
            Recording(samples if metadata else first_samples, metadata=metadata), folder / "log.mcap"
        )
        arguments = ["fuse", folder / "log.mcap", "--vehicle", folder / "vehicle.toml", "-o", folder / "out"]
        assert main([str(argument) for argument in arguments]) == 0
        result = json.loads((folder / "out" / "fuse.json").read_text())
        assert source in result["ranges"]["left"]["gyro_range"]["source"]
        assert result["ranges"]["left"]["gyro_range"]["value"] == pytest.approx(math.radians(500.0), rel=1e-3)
        if metadata:
            assert result["distance"] == pytest.approx(length, rel=0.01)
    capsys.readouterr()
