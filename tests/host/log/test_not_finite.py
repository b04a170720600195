"""NaN and infinity in a log: the rows are left out, counted, and reported by every verb."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from generators.fake_drive import VEHICLE_TOML, short_drive
from generators.gnss_drives import geodetic
from hubodo.cli import main
from hubodo.ingest.replay.playback import Playback
from hubodo.log.recording_reader import read_recording
from hubodo.log.recording_writer import write_recording
from hubodo.recording import Recording, Table
from hubodo.vehicle import load_vehicle
from wheel_runs import tables

SEED = 3
ROWS_NOT_FINITE = {"left": 7, "right": 3, "gnss": 4, "reference": 5}


def _with_value(table: Table, column: str, places: slice, value: float) -> Table:
    columns = {name: values.copy() for name, values in table.columns.items()}
    columns[column][places] = value
    return Table(columns)


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> Path:
    """Write a log of two nodes, GNSS and reference, each with rows that are not finite."""
    drive, nodes = short_drive(SEED), tables(short_drive(SEED))
    t = np.arange(0.5, 10.5, 0.2)
    x, y = (np.interp(t, drive.t, column) for column in (drive.x, drive.y))
    latitude, longitude = geodetic(47.37, 8.54, x, y)
    fixes = {"t": t, "latitude_deg": latitude, "longitude_deg": longitude, "altitude": np.full(len(t), 400.0)}
    reference = {
        "t": drive.t[::20],
        "speed": drive.speed[::20],
        "yaw_rate": np.gradient(drive.heading, drive.t)[::20],
    }
    recording = Recording(
        {
            "left": _with_value(nodes["left"], "gy", slice(800, 807), np.nan),
            "right": _with_value(nodes["right"], "ax", slice(900, 903), np.inf),
        },
        gnss=_with_value(Table(fixes), "latitude_deg", slice(10, 14), np.nan),
        reference=_with_value(Table(reference), "speed", slice(100, 105), -np.inf),
    )
    folder = tmp_path_factory.mktemp("unsound")
    write_recording(recording, folder / "log.mcap")
    (folder / "vehicle.toml").write_text(VEHICLE_TOML)
    (folder / "model.toml").write_text(
        VEHICLE_TOML.replace("[nodes.left]", "[imu]\ngyro_noise = 0.002\naccel_noise = 0.2\n[nodes.left]", 1)
    )
    return folder / "log.mcap"


def test_rows_that_are_not_finite_are_left_out_counted_and_reported(log: Path) -> None:
    recording = read_recording(log)
    for name, count in ROWS_NOT_FINITE.items():
        assert any(f"{name}: {count} of" in line and "NaN" in line for line in recording.warnings), (
            recording.warnings
        )
        table = recording.files()[name]
        assert all(np.isfinite(values).all() for values in table.columns.values())


def test_a_node_without_any_finite_row_is_left_out(log: Path, tmp_path: Path) -> None:
    recording = read_recording(log)
    left = _with_value(recording.nodes["left"], "az", slice(None), np.nan)
    write_recording(replace(recording, nodes={**recording.nodes, "left": left}), tmp_path / "log.mcap")
    assert "left" not in read_recording(tmp_path / "log.mcap").nodes


@pytest.mark.parametrize(
    ("command", "is_reported"),
    [
        (["fuse", "LOG", "--vehicle", "vehicle.toml", "-o", "OUT/fused", "--json"], True),
        (["info", "LOG", "--json"], True),
        (["report", "LOG", "-o", "OUT/page.html"], True),
        (["calibrate", "wheels", "LOG", "--vehicle", "vehicle.toml", "-o", "OUT/c.toml", "--json"], True),
        (["calibrate", "imu", "LOG", "--node", "left", "-o", "OUT/c.toml", "--json"], False),
        (["export", "LOG", "-o", "OUT/folder"], True),
        (["export", "LOG", "--format", "parquet", "-o", "OUT/parquet"], True),
        (["gap", "model.toml", "LOG", "-o", "OUT/gap"], True),
    ],
    ids=lambda command: "-".join(command[:3]) if isinstance(command, list) else "",
)
def test_every_verb_accepts_such_a_log_or_refuses_it_in_one_line(
    log: Path, command: list[str], is_reported: bool, tmp_path: Path, monkeypatch, capfd
) -> None:
    monkeypatch.chdir(log.parent)
    code = main([argument.replace("LOG", "log.mcap").replace("OUT", str(tmp_path)) for argument in command])
    out, err = capfd.readouterr()
    assert code in (0, 2), err
    if code == 2:
        assert err.count("\n") == 1, err
        assert not any(tmp_path.iterdir()), "an incomplete result"
        return
    for path in tmp_path.rglob("*.csv"):
        # These logs have no optional columns such as a temperature, which may be NaN.
        assert not re.search(r"(^|,)-?(nan|inf)", path.read_text(), re.IGNORECASE | re.MULTILINE), path
    for text in [out] * ("--json" in command) + [path.read_text() for path in tmp_path.rglob("*.json")]:
        json.loads(text, parse_constant=_refuse)
    if is_reported:
        output = out + err + "".join(path.read_text() for path in tmp_path.rglob("*.html"))
        assert "NaN or infinity" in output, output[:2000]


def _refuse(constant: str) -> None:
    raise AssertionError(f"{constant} in JSON")


def test_playback_odometry_bridges_the_rows_left_out(log: Path) -> None:
    vehicle = load_vehicle(log.parent / "vehicle.toml")
    motions = list(Playback(log, vehicle=vehicle).odometry_rows())
    position = np.concatenate([motion.position for motion in motions])
    assert np.isfinite(position).all()
    assert np.hypot(*(position[-1] - position[0])) > 3.0
