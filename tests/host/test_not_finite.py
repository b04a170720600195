"""NaN and infinity in a log of somebody else: gaps that are counted and said by every verb that reads one."""

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
BAD = {"left": 7, "right": 3, "gnss": 4, "reference": 5}


def _with(table: Table, column: str, places: slice, value: float) -> Table:
    columns = {name: values.copy() for name, values in table.columns.items()}
    columns[column][places] = value
    return Table(columns)


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> Path:
    """Both nodes, GNSS and reference, each with rows that are not finite."""
    made, nodes = short_drive(SEED), tables(short_drive(SEED))
    t = np.arange(0.5, 10.5, 0.2)
    x, y = (np.interp(t, made.t, column) for column in (made.x, made.y))
    latitude, longitude = geodetic(47.37, 8.54, x, y)
    fixes = {"t": t, "latitude_deg": latitude, "longitude_deg": longitude, "altitude": np.full(len(t), 400.0)}
    reference = {
        "t": made.t[::20],
        "speed": made.speed[::20],
        "yaw_rate": np.gradient(made.heading, made.t)[::20],
    }
    recording = Recording(
        {
            "left": _with(nodes["left"], "gy", slice(800, 807), np.nan),
            "right": _with(nodes["right"], "ax", slice(900, 903), np.inf),
        },
        gnss=_with(Table(fixes), "latitude_deg", slice(10, 14), np.nan),
        reference=_with(Table(reference), "speed", slice(100, 105), -np.inf),
    )
    folder = tmp_path_factory.mktemp("unsound")
    write_recording(recording, folder / "log.mcap")
    (folder / "vehicle.toml").write_text(VEHICLE_TOML)
    (folder / "model.toml").write_text(
        VEHICLE_TOML.replace("[nodes.left]", "[imu]\ngyro_noise = 0.002\naccel_noise = 0.2\n[nodes.left]", 1)
    )
    return folder / "log.mcap"


def test_rows_that_are_not_finite_are_left_out_counted_and_said(log: Path) -> None:
    found = read_recording(log)
    for name, count in BAD.items():
        assert any(f"{name}: {count} of" in line and "NaN" in line for line in found.warnings), found.warnings
        table = found.files()[name]
        assert all(np.isfinite(values).all() for values in table.columns.values())


def test_a_node_of_nothing_else_is_not_there(log: Path, tmp_path: Path) -> None:
    whole = read_recording(log)
    left = _with(whole.nodes["left"], "az", slice(None), np.nan)
    write_recording(replace(whole, nodes={**whole.nodes, "left": left}), tmp_path / "log.mcap")
    assert "left" not in read_recording(tmp_path / "log.mcap").nodes


@pytest.mark.parametrize(
    ("words", "said"),
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
    ids=lambda words: "-".join(words[:3]) if isinstance(words, list) else "",
)
def test_every_verb_takes_it_or_says_in_one_line_why_not(
    log: Path, words: list[str], said: bool, tmp_path: Path, monkeypatch, capfd
) -> None:
    monkeypatch.chdir(log.parent)
    code = main([word.replace("LOG", "log.mcap").replace("OUT", str(tmp_path)) for word in words])
    out, err = capfd.readouterr()
    assert code in (0, 2), err
    if code == 2:
        assert err.count("\n") == 1, err
        assert not any(tmp_path.iterdir()), "a half-written result"
        return
    for path in tmp_path.rglob("*.csv"):
        # What is not known otherwise (a temperature) is not asked for here.
        assert not re.search(r"(^|,)-?(nan|inf)", path.read_text(), re.IGNORECASE | re.MULTILINE), path
    for text in [out] * ("--json" in words) + [path.read_text() for path in tmp_path.rglob("*.json")]:
        json.loads(text, parse_constant=_refuse)
    if said:
        heard = out + err + "".join(path.read_text() for path in tmp_path.rglob("*.html"))
        assert "NaN or infinity" in heard, heard[:2000]


def _refuse(word: str) -> None:
    raise AssertionError(f"{word} in JSON")


def test_the_odometry_of_a_playback_goes_over_it(log: Path) -> None:
    vehicle = load_vehicle(log.parent / "vehicle.toml")
    motions = list(Playback(log, vehicle=vehicle).odometry_rows())
    place = np.concatenate([motion.position for motion in motions])
    assert np.isfinite(place).all()
    assert np.hypot(*(place[-1] - place[0])) > 3.0
