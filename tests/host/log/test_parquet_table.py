"""Parquet files of `export --format parquet` are read as a log; hostile ones are refused in one line."""

import json
import random
from pathlib import Path

import numpy as np
import pyarrow
import pyarrow.parquet as parquet
import pytest

import wanted
from hubodo.log.any_log import read_log
from hubodo.log.csv_folder import write_folder
from hubodo.recording import NODE_COLUMNS, Recording, Table
from in_process import hubodo

N = 200
RNG = np.random.default_rng(2)
COLUMNS = {name: RNG.normal(size=N) for name in NODE_COLUMNS[1:]}
T = np.arange(N) * 0.01
RECORDING = Recording(
    {"left": Table({"t": T, **COLUMNS, "temperature": np.full(N, np.nan), "left wheel": T**2})},
    reference=Table({"t": T, "speed": T, "yaw_rate": -T}),
    truth=Table({"t": T, "x": T, "y": -T}),
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    wanted.module("pyarrow.parquet")
    write_folder(RECORDING, tmp_path / "log", table_format="parquet")
    return tmp_path / "log"


def rewrite(file: Path, **columns: object) -> None:
    """Rewrite the file with other columns; None removes a column."""
    arrow, parquet = wanted.module("pyarrow"), wanted.module("pyarrow.parquet")
    table = {**parquet.read_table(file).to_pydict(), **columns}
    parquet.write_table(arrow.table({name: it for name, it in table.items() if it is not None}), file)


def test_an_exported_folder_is_read_as_the_same_log(folder, tmp_path):
    read = read_log(folder)
    for name, table in RECORDING.files().items():
        assert set(read.files()[name]) == set(table)
        for column in table:
            assert np.array_equal(read.files()[name][column], table[column], equal_nan=True)
    done = hubodo("info", folder, "--json")
    assert done.code == 0, done.err
    assert {it["topic"]: it["messages"] for it in json.loads(done.out)["streams"]}["/left/imu"] == N
    assert hubodo("import", folder, "-o", tmp_path / "again.mcap").code == 0
    assert np.array_equal(read_log(tmp_path / "again.mcap").nodes["left"].gyro, RECORDING.nodes["left"].gyro)


def test_one_file_is_a_node(folder):
    read = read_log(folder / "left.parquet")
    assert list(read.nodes) == ["left"]
    assert np.array_equal(read.nodes["left"].accel, RECORDING.nodes["left"].accel)
    assert hubodo("info", folder / "left.parquet").code == 0


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"gz": None}, "no column of numbers gz"),
        ({"gz": ["x"] * N}, "no column of numbers gz"),
        ({"gz": [1.0, None, *[2.0] * (N - 2)]}, "row 2: NaN or infinity"),
        ({"t": [0.0, 2.0, 1.0, *range(3, N)]}, "row 3: time does not increase"),
        ({"t": [*range(N - 1), 1e12]}, f"row {N}: time beyond 68 years"),
        ({f"c{i}": [0.0] * N for i in range(1001)}, "write it with up to 1000 different ones"),
    ],
    ids=["missing", "text", "null", "order", "beyond", "many"],
)
def test_a_faulty_file_is_refused_with_its_row(columns, words, folder, tmp_path):
    rewrite(folder / "left.parquet", **columns)
    done = hubodo("info", folder)
    assert (done.code, done.err.count("\n")) == (2, 1)
    assert words in done.err
    if "row" in words:
        done = hubodo("import", folder, "--repair", "-o", tmp_path / "x.mcap", "--json")
        assert json.loads(done.out)["rows"]["left"] == N - 1


def test_a_table_beyond_the_memory_limit_is_not_read(folder):
    done = hubodo("info", folder, "--max-memory", 0.03)
    assert done.code == 2
    assert "left.parquet: the table needs 43200 bytes of memory" in done.err


def test_randomly_changed_bytes_cause_no_internal_error(folder):
    good, seed = (folder / "left.parquet").read_bytes(), 5
    for case in range(60):
        rng = random.Random(f"{seed} {case}")
        data = bytearray(good)
        for _ in range(rng.randint(1, 4)):
            at = rng.randrange(len(data)) if rng.random() < 0.4 else len(data) - rng.randrange(1, 2500)
            data[at] = rng.randrange(256)
        (folder / "left.parquet").write_bytes(
            data[: rng.choice((len(data), len(data), rng.randrange(len(data))))]
        )
        done = hubodo("export", folder, "-o", folder.parent / f"out{case}")
        assert done.code in (0, 2), f"seed {seed}, case {case}: {done.err}"
        assert "defect" not in done.err, f"seed {seed}, case {case}: {done.err}"


def test_a_file_of_another_program_is_read_by_its_headings_and_dates(tmp_path):
    stamps = np.datetime64("2026-03-01T12:00:00.25") + np.arange(50) * np.timedelta64(10, "ms")
    columns = {"timestamp": stamps.astype("datetime64[us]"), "gyro_x [deg/s]": np.arange(50.0)}
    columns |= {"note": ["x"] * 50}
    path = tmp_path / "lab.parquet"
    parquet.write_table(pyarrow.table(columns), path)
    recording = read_log(path)
    table = recording.nodes["lab"]
    assert table.t == pytest.approx(0.25 + 0.01 * np.arange(50), abs=1e-6)
    assert recording.t_zero_ns == 1772366400 * 10**9
    assert table["gx"] == pytest.approx(np.radians(np.arange(50.0)))
