"""The CSV folder: import and export preserve every number, and every fault is named."""

import gzip
import json
import math
import struct
import subprocess
import sys
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import wanted
from hubodo.errors import InputError
from hubodo.log import csv_table
from hubodo.log.csv_folder import read_folder, write_folder
from hubodo.log.recording_reader import read_recording
from hubodo.log.recording_writer import write_recording
from hubodo.log.timebase import to_ns, to_seconds
from repetitions import first_and_more

NODE = ["t", "gx", "gy", "gz", "ax", "ay", "az"]
FILES = {
    "left": (NODE, ["temperature", "supply"]),
    "a node, 7": (NODE, ["temperature"]),
    "reference": (["t", "speed", "yaw_rate"], ["temperature"]),
    "wheels": (["t", "left", "right"], []),
    "gnss": (["t", "latitude_deg", "longitude_deg", "altitude"], ["sigma"]),
    "heading": (["t", "heading"], ["sigma"]),
    "table": (["t", "angle", "moving"], []),
    "truth": (["t", "x", "y"], ["heading"]),
    "left.high_g": (["t", "ax", "ay", "az"], []),
}
SPECIAL_NUMBERS = st.sampled_from(
    ["-0.0", "0", "1e-310", "-5e-324", "1.7976931348623157e308", "0.1", "1E5", "+3", ".5", "7.", "00.10",
     "0.30000000000000004", "123456789012345680", "2.2250738585072014e-308", " 1 ", '"2.5"']
)  # fmt: skip
NUMBER = SPECIAL_NUMBERS | st.floats(allow_nan=False, allow_infinity=False).map(repr)
TIMES = st.lists(
    st.floats(-1e6, 1e6) | st.floats(0, 2.1e9)
    | st.sampled_from([0.0, 1e-310, 2e-310, 5e-324, 0.1, 1.7e9 + 0.0025])
    | st.decimals(0, 10000, places=9, allow_nan=False).map(float),
    max_size=12, unique_by=lambda t: t + 0.0,
)  # fmt: skip
NAMES = st.text(st.characters(exclude_categories=["Cc", "Cs", "Zl", "Zp"]), max_size=6).map(str.strip)


@st.composite
def csv_file(draw: st.DrawFn, name: str, rows: int) -> bytes:
    required, optional = FILES[name]
    unknown = draw(st.lists(NAMES, max_size=3, unique=True))
    columns = required + [c for c in optional if draw(st.booleans())]
    columns += [c for c in unknown if c not in columns and c not in optional]
    columns = draw(st.permutations(columns))
    times = sorted(draw(TIMES.filter(lambda values: len(values) >= rows)))
    end = draw(st.sampled_from(["\n", "\r\n"]))
    quoted = ['"' + c.replace('"', '""') + '"' if set(c) & set(',"#') else c for c in columns]
    lines = [",".join(quoted)]
    if draw(st.booleans()):
        lines.insert(0, "# a comment, with commas, before the header")
    for t in times:
        if draw(st.integers(0, 9)) == 0:
            lines.append(draw(st.sampled_from(["", "# in between", "   # indented"])))
        lines.append(",".join(repr(t) if c == "t" else draw(NUMBER) for c in columns))
    text = end.join(lines) + draw(st.sampled_from(["", end]))
    return ("\ufeff" * draw(st.booleans()) + text).encode()


def parse(data: bytes) -> dict[str, list[float]]:
    """Parse with the csv module row by row, independently of the reader under test."""
    import csv

    lines = [
        line for line in data.decode("utf-8-sig").splitlines() if line.strip() and line.strip()[0] != "#"
    ]
    rows = list(csv.reader(lines))
    return {name.strip(): [float(row[i]) for row in rows[1:]] for i, name in enumerate(rows[0])}


def bits(values: list[float]) -> list[bytes]:
    return [struct.pack("<d", value) for value in values]


@settings(max_examples=10)
@given(data=st.data())
def test_import_then_export_gives_back_every_number_of_every_column(
    data: st.DataObject, tmp_path_factory
) -> None:
    root = tmp_path_factory.mktemp("folder")
    others = data.draw(st.lists(st.sampled_from(list(FILES)[1:]), unique=True, max_size=4))
    given_files = {}
    (root / "in").mkdir()
    for name in ["left", *others]:
        content = data.draw(csv_file(name, 1 if name in ("left", "a node, 7") else 0))
        given_files[name] = parse(content)
        if data.draw(st.booleans()):
            (root / "in" / f"{name}.csv.gz").write_bytes(gzip.compress(content))
        else:
            (root / "in" / f"{name}.csv").write_bytes(content)
    write_recording(read_folder(root / "in"), root / "log.mcap")
    write_folder(read_recording(root / "log.mcap"), root / "out")
    assert {path.stem for path in (root / "out").iterdir()} == set(given_files)
    for name, columns in given_files.items():
        returned = parse((root / "out" / f"{name}.csv").read_bytes())
        assert list(returned) == list(columns)
        for column, values in columns.items():
            assert bits(returned[column]) == bits(values), (name, column)


@pytest.mark.parametrize("name", first_and_more("wheelchair", "multipose"))
def test_import_and_export_preserve_every_number_of_a_real_recording(name: str, tmp_path: Path) -> None:
    folder = wanted.recording(name)
    write_recording(read_folder(folder), tmp_path / "log.mcap")
    write_folder(read_recording(tmp_path / "log.mcap"), tmp_path / "out")
    for path in folder.glob("*.csv.gz"):
        original, returned = gzip.decompress(path.read_bytes()), (tmp_path / "out" / path.stem).read_bytes()
        assert returned.splitlines()[0] == original.splitlines()[0]
        assert parse(returned) == parse(original)


@pytest.mark.repeat
def test_import_and_export_preserve_a_million_real_rows(tmp_path: Path) -> None:
    folder = wanted.recording("static")
    recording = read_folder(folder)
    assert len(recording.nodes["node"]) == 1_000_000
    write_recording(recording, tmp_path / "log.mcap")
    returned = read_recording(tmp_path / "log.mcap").nodes["node"]
    for name, column in recording.nodes["node"].columns.items():
        assert np.array_equal(returned[name].view(np.int64), column.view(np.int64)), name


def folder_with(tmp_path: Path, **files: str) -> Path:
    folder = tmp_path / "folder"
    folder.mkdir(exist_ok=True)
    for name, text in files.items():
        (folder / f"{name}.csv").write_text(text)
    return folder


GOOD = "t,gx,gy,gz,ax,ay,az\n" + "".join(f"{i / 100},1,2,3,4,5,6\n" for i in range(10))


def with_row(row: str) -> str:
    """Return GOOD with its eighth row (line 9 of the file) replaced."""
    lines = GOOD.splitlines()
    lines[8] = row
    return "\n".join(lines) + "\n"


FAULTS = {
    "0.07,1,2,x,4,5,6": "row 9: not a number: gz is 'x'",
    "0.07,1,2,,4,5,6": "row 9: not a number: gz is ''",
    "0.07,1,2,3,4,5": "row 9: wrong number of columns: 6 instead of 7",
    "0.07,1,2,3,4,5,6,7": "row 9: wrong number of columns: 8 instead of 7",
    "0.07,1,2,3,4,5,6,": "row 9: wrong number of columns: 8 instead of 7",
    "0.07,1,2,nan,4,5,6": "row 9: NaN or infinity: gz is 'nan'",
    "0.07,1,2,3,4,5,-inf": "row 9: NaN or infinity: az is '-inf'",
    "0.07,1,2,3,4,5,1e999": "row 9: NaN or infinity: az is '1e999'",
    "0.06,1,2,3,4,5,6": "row 9: time does not increase: t = 0.06 comes after 0.06",
    "0.01,1,2,3,4,5,6": "row 9: time does not increase: t = 0.01 comes after 0.06",
    "1_0,1,2,3,4,5,6": "row 9: not a number: t is '1_0'",
    "0x1,1,2,3,4,5,6": "row 9: not a number: t is '0x1'",
    "1700000000123,1,2,3,4,5,6": "row 9: time beyond 68 years: t = 1700000000123.0; t is in seconds",
}


@pytest.mark.parametrize(("row", "text"), FAULTS.items())
def test_a_faulty_row_is_refused_with_file_row_and_remedy(row: str, text: str, tmp_path: Path) -> None:
    folder = folder_with(tmp_path, left=GOOD, right=with_row(row))
    with pytest.raises(InputError) as caught:
        read_folder(folder)
    assert "right.csv: " + text in str(caught.value)
    assert "--repair" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("row", "text"), FAULTS.items())
def test_repair_drops_the_faulty_row_and_records_it_in_the_log(row: str, text: str, tmp_path: Path) -> None:
    folder = folder_with(tmp_path, left=GOOD, right=with_row(row))
    write_recording(read_folder(folder, repair=True), tmp_path / "log.mcap")
    returned = read_recording(tmp_path / "log.mcap")
    kind = text.split(": ")[1]
    assert json.loads(returned.metadata["repaired"]) == {"right.csv": {kind: 1}}
    (event,) = returned.events
    assert (event.kind, event.source, event.data["dropped"]) == ("repaired", "right.csv", {kind: 1})
    assert len(returned.nodes["left"]) == 10
    assert returned.nodes["right"].t.tolist() == [i / 100 for i in range(10) if i != 7]


@pytest.mark.parametrize("end", ["", "\n", "\r\n"])
def test_an_empty_last_cell_at_the_end_of_the_file_is_refused(end: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"row 12: not a number: az is ''"):
        read_folder(folder_with(tmp_path, left=GOOD + "0.5,1,2,3,4,5," + end))


def test_repair_counts_each_kind_in_each_file(tmp_path: Path) -> None:
    bad = with_row("0.07,1,2,x,4,5,6") + "0.05,1,2,3,4,5,6\n0.2,nan,2,3,4,5,6\n0.3,1\n0.3,2\n"
    events = read_folder(folder_with(tmp_path, left=bad, right=GOOD), repair=True).events
    assert [event.data["dropped"] for event in events] == [
        {
            "not a number": 1,
            "NaN or infinity": 1,
            "wrong number of columns": 2,
            "time does not increase": 1,
        }
    ]


def test_repair_drops_one_wild_time_stamp_and_not_all_rows_after_it(tmp_path: Path) -> None:
    recording = read_folder(folder_with(tmp_path, left=with_row("5000,1,2,3,4,5,6")), repair=True)
    assert recording.nodes["left"].t.tolist() == [i / 100 for i in range(10) if i != 7]


def test_repair_finds_faults_anywhere_in_a_file_of_many_blocks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(csv_table, "_CSV_BLOCK_BYTES", 1 << 16)
    lines = ["t,gx,gy,gz,ax,ay,az"] + [f"{i},0.123456789,2,3,4,5,6" for i in range(40_000)]
    lines[30_001] = "30000,?,2,3,4,5,6"
    lines[39_000] = "3,1,2,3,4,5,6"
    folder = folder_with(tmp_path, left="\n".join(lines))
    with pytest.raises(InputError, match=r"left\.csv: row 30002: not a number: gx is '\?'"):
        read_folder(folder)
    repaired = read_folder(folder, repair=True)
    assert len(repaired.nodes["left"]) == 39_998
    assert repaired.events[0].data["dropped"] == {"not a number": 1, "time does not increase": 1}


HEADERS = {
    "t,gx,gy,gz,ax,ay\n0,1,2,3,4,5\n": "row 1: no column az",
    "# made by hand\n\nt;gx;gy;gz;ax;ay;az\n0;1;2;3;4;5;6\n": "row 3: no column t, gx",
    "0,1,2,3,4,5,6\n": "row 1: no column t, gx",
    "t,gx,gy,gz,ax,ay,az,gx\n0,1,2,3,4,5,6,7\n": "row 1: column 'gx' appears twice",
    "": "is empty",
    "# only a comment\n": "is empty",
    "t,gx,gy,gz,ax,ay,az\n": "no rows remain below the header",
}


@pytest.mark.parametrize("repair", [False, True])
@pytest.mark.parametrize(("text", "reason"), HEADERS.items())
def test_a_file_without_usable_header_or_rows_is_refused_even_with_repair(
    text: str, reason: str, repair: bool, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=r"left\.csv: " + reason):
        read_folder(folder_with(tmp_path, left=text), repair=repair)


def test_a_folder_without_a_node_is_refused(tmp_path: Path) -> None:
    folder = folder_with(tmp_path, gnss="t,latitude_deg,longitude_deg,altitude\n0,50,7,100\n")
    (folder / "README.md").write_text("left.csv is missing")
    with pytest.raises(InputError, match="holds no node"):
        read_folder(folder)
    with pytest.raises(InputError, match="is not a folder"):
        read_folder(tmp_path / "absent")


def test_the_same_file_plain_and_gzipped_is_refused(tmp_path: Path) -> None:
    folder = folder_with(tmp_path, left=GOOD)
    (folder / "left.csv.gz").write_bytes(gzip.compress(GOOD.encode()))
    with pytest.raises(InputError, match=r"holds both left\.csv and left\.csv\.gz"):
        read_folder(folder)


@pytest.mark.parametrize("damage", [b"no gzip at all", gzip.compress(GOOD.encode(), mtime=0)[:-12]])
def test_a_broken_gzip_file_is_refused_in_one_line(damage: bytes, tmp_path: Path) -> None:
    folder = folder_with(tmp_path)
    (folder / "left.csv.gz").write_bytes(damage)
    with pytest.raises(InputError, match=r"left\.csv\.gz: cannot be read"):
        read_folder(folder)


def test_a_file_that_is_not_utf8_is_refused_with_its_row(tmp_path: Path) -> None:
    folder = folder_with(tmp_path)
    (folder / "left.csv").write_bytes(GOOD.encode() + b"0.5,1,2,3,4,5,6 # \xe4\n")
    with pytest.raises(InputError, match=r"left\.csv: row 12: is not UTF-8"):
        read_folder(folder)


def test_negative_times_are_preserved_although_times_of_a_log_cannot_be_negative(tmp_path: Path) -> None:
    text = GOOD.replace("\n0.0,", "\n-1.25,")
    write_recording(read_folder(folder_with(tmp_path, left=text)), tmp_path / "log.mcap")
    returned = read_recording(tmp_path / "log.mcap")
    assert returned.t_zero_ns == 2_000_000_000
    assert returned.nodes["left"].t[0] == -1.25


def test_seconds_since_1970_with_nine_decimals_are_preserved(tmp_path: Path) -> None:
    times = [f"17000000{i:02d}.{(i * 7919 * 12347) % 10**9:09d}" for i in range(10)]
    times += ["1700000010", "1700000010.5", "1700000011.000000001", "1700000012.1234567890000"]
    rows = "".join(f"1,{t},2,3,4,5,6\n" for t in times)
    folder = folder_with(tmp_path, left="gx,t,gy,gz,ax,ay,az\n" + rows, right=GOOD)
    (folder / "frame.csv").write_text(
        "# slow\ngx,t,gy,gz,ax,ay,az\n# path\n" + rows + "1,1700000012.2,nan,3,4,5,6\n"
    )
    write_recording(read_folder(folder, repair=True), tmp_path / "log.mcap")
    write_folder(read_recording(tmp_path / "log.mcap"), tmp_path / "out")
    for name in ("left", "frame"):
        back = [line.split(",")[1] for line in (tmp_path / "out" / f"{name}.csv").read_text().splitlines()]
        assert list(map(Decimal, back[1:])) == list(map(Decimal, times))
    assert read_recording(tmp_path / "log.mcap").nodes["right"].t.tolist() == [i / 100 for i in range(10)]


def test_a_killed_import_leaves_no_file_of_that_name(tmp_path: Path) -> None:
    folder = folder_with(tmp_path, left=GOOD)
    program = (
        "import os, signal, sys; from pathlib import Path\n"
        "from hubodo.log import csv_folder, recording_writer\n"
        "def die(text, fraction): os.kill(os.getpid(), signal.SIGKILL)\n"
        "source, target = map(Path, sys.argv[1:])\n"
        "recording_writer.write_recording(csv_folder.read_folder(source), target, progress=die)\n"
    )
    target = tmp_path / "log.mcap"
    killed = subprocess.run([sys.executable, "-c", program, folder, target], check=False, timeout=300)
    assert killed.returncode == -9
    assert not target.exists()


def test_export_overwrites_no_file_and_leaves_no_incomplete_one(tmp_path: Path) -> None:
    recording = read_folder(folder_with(tmp_path, left=GOOD))
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("kept")
    with pytest.raises(InputError, match="not empty"):
        write_folder(recording, tmp_path / "full")
    assert [path.name for path in (tmp_path / "full").iterdir()] == ["mine.txt"]

    def fail(text: str, fraction: float) -> None:
        raise OSError(28, "No space left on device")

    before = sorted(tmp_path.iterdir())
    with pytest.raises(OSError, match="No space"):
        write_folder(recording, tmp_path / "new", progress=fail)
    assert sorted(tmp_path.iterdir()) == before


def test_parquet_holds_the_same_numbers(tmp_path: Path) -> None:
    parquet = wanted.module("pyarrow.parquet")
    recording = read_folder(folder_with(tmp_path, left=GOOD))
    assert write_folder(recording, tmp_path / "out", table_format="parquet") == ("left.parquet",)
    table = parquet.read_table(tmp_path / "out" / "left.parquet")
    assert table.column_names == NODE
    for name in NODE:
        assert np.array_equal(table[name].to_numpy(), recording.nodes["left"][name])


def test_parquet_without_pyarrow_names_the_package_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = read_folder(folder_with(tmp_path, left=GOOD))
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(InputError, match=r"pip install 'hubodo\[parquet\]'"):
        write_folder(recording, tmp_path / "out", table_format="parquet")
    assert not (tmp_path / "out").exists()


@given(t=st.floats(-2e9, 2e9), zero=st.integers(0, 10**18))
def test_whole_nanoseconds_are_read_as_the_nearest_float(t: float, zero: int) -> None:
    t_ns = to_ns(np.array([t]), zero)
    exact = Decimal(t) * 10**9
    assert abs(Decimal(int(t_ns[0]) - zero) - exact) <= Decimal("0.6")
    nearest = float(Decimal(int(t_ns[0]) - zero) / 10**9)
    assert math.isclose(to_seconds(t_ns, zero)[0], nearest, rel_tol=3e-16, abs_tol=0)
