"""`hubodo import` and `hubodo export`: output, exit codes, and errors of one line."""

import csv
import json
from pathlib import Path

import pytest

from hubodo.cli import main
from hubodo.fuse.track_files import TRACK_WRITERS
from hubodo.verbs.export import TRACK_FORMATS

GOOD = "t,gx,gy,gz,ax,ay,az,left wheel\n" + "".join(f"{i / 8},{i},2,3,4,5,6,-0.0\n" for i in range(10))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    drive = tmp_path / "drive"
    drive.mkdir()
    (drive / "left.csv").write_text(GOOD)
    (drive / "gnss.csv").write_text("t,latitude_deg,longitude_deg,altitude\n0.5,50.1,7.2,100\n")
    return drive


def test_export_is_the_inverse_of_import(folder: Path, tmp_path: Path, capsys) -> None:
    assert main(["import", str(folder), "-o", str(tmp_path / "a.mcap")]) == 0
    assert main(["export", str(tmp_path / "a.mcap"), "-o", str(tmp_path / "back")]) == 0
    for name in ("left.csv", "gnss.csv"):
        given, back = (list(csv.reader((at / name).open())) for at in (folder, tmp_path / "back"))
        assert given[0] == back[0]
        assert [list(map(float, row)) for row in given[1:]] == [list(map(float, row)) for row in back[1:]]
        assert "-0.0" in (tmp_path / "back" / "left.csv").read_text()
    assert capsys.readouterr().err == ""


def test_json_has_rows_messages_and_the_rows_dropped_by_repair(folder: Path, tmp_path: Path, capsys) -> None:
    (folder / "left.csv").write_text(GOOD + "nan,1,2,3,4,5,6,7\n")
    assert main(["import", str(folder), "-o", str(tmp_path / "a.mcap"), "--repair", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["rows"] == {"left": 10, "gnss": 1}
    assert result["dropped"] == {"left.csv": {"NaN or infinity": 1}}
    assert main(["info", str(tmp_path / "a.mcap"), "--json"]) == 0
    info = json.loads(capsys.readouterr().out)
    assert [event["text"] for event in info["events"]] == [
        "left.csv: dropped 1 rows on import: 1 NaN or infinity"
    ]


def test_a_faulty_folder_exits_2_with_one_line_and_writes_nothing(
    folder: Path, tmp_path: Path, capsys
) -> None:
    (folder / "left.csv").write_text(GOOD + "9,1,2,inf,4,5,6,7\n")
    before = sorted(tmp_path.rglob("*"))
    assert main(["import", str(folder), "-o", str(tmp_path / "a.mcap")]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert err.startswith("hubodo import: ")
    assert f"{folder / 'left.csv'}: row 12: NaN or infinity: gz is 'inf'" in err
    assert sorted(tmp_path.rglob("*")) == before


def test_an_existing_output_exits_2_and_stays(folder: Path, tmp_path: Path, capsys) -> None:
    (tmp_path / "a.mcap").write_bytes(b"precious")
    assert main(["import", str(folder), "-o", str(tmp_path / "a.mcap")]) == 2
    assert "exists already" in capsys.readouterr().err
    assert (tmp_path / "a.mcap").read_bytes() == b"precious"


@pytest.mark.parametrize(
    "argv",
    [["import"], ["import", "x"], ["export", "x", "-o", "y", "--format", "xml"], ["nonsense"]],
)
def test_wrong_usage_exits_2_with_one_line(argv: list[str], capsys) -> None:
    assert main(argv) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "--help" in err


def test_export_of_a_foreign_file_exits_2(tmp_path: Path, capsys) -> None:
    (tmp_path / "song.mp3").write_bytes(b"ID3" + bytes(1000))
    assert main(["export", str(tmp_path / "song.mp3"), "-o", str(tmp_path / "out")]) == 2
    assert "is not an MCAP file" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_only_debug_adds_the_traceback(tmp_path: Path, capsys) -> None:
    assert main(["info", str(tmp_path / "absent.mcap")]) == 2
    assert "Traceback" not in capsys.readouterr().err
    assert main(["info", str(tmp_path / "absent.mcap"), "--debug"]) == 2
    assert "Traceback" in capsys.readouterr().err


def test_export_to_a_folder_without_permission_exits_1_with_one_line(
    folder: Path, tmp_path: Path, capsys
) -> None:
    assert main(["import", str(folder), "-o", str(tmp_path / "a.mcap")]) == 0
    capsys.readouterr()
    assert main(["export", str(tmp_path / "a.mcap"), "-o", "/proc/nowhere"]) in (1, 2)
    assert capsys.readouterr().err.count("\n") == 1


def test_a_fused_track_is_exported_with_the_origin_of_its_fixes(tmp_path: Path, capsys) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "track.csv").write_text("t,x,y,heading\n1,0,0,0\n2,100,0,0.5\n")
    origin = {"latitude_deg": 47.0, "longitude_deg": 8.0}
    report = {"t_zero_ns": 1_790_000_000_000_000_000, "graph": {"origin": origin}}
    (tmp_path / "out" / "fuse.json").write_text(json.dumps(report))
    command = ["export", str(tmp_path / "out"), "--format", "geojson", "-o", str(tmp_path / "a.geojson")]
    assert main([*command, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["rows"] == {"track": 2}
    by_file = main(
        [
            str(word)
            for word in (
                "export",
                tmp_path / "out" / "track.csv",
                "--format",
                "tum",
                "-o",
                tmp_path / "tum.txt",
            )
        ]
    )
    assert (by_file, len((tmp_path / "tum.txt").read_text().splitlines())) == (0, 2)
    (feature,) = json.loads((tmp_path / "a.geojson").read_text())["features"]
    assert feature["geometry"]["coordinates"][0] == [8.0, 47.0]
    # 100 m to the east at 47 degrees north.
    assert feature["geometry"]["coordinates"][1][0] == pytest.approx(8.0 + 100 / 76_056, abs=1e-5)
    assert feature["properties"]["coordTimes"][0] == "2026-09-21T14:13:21.000Z"
    assert main(command) == 2
    assert "give --force to replace it" in capsys.readouterr().err


def test_the_option_offers_every_format_of_a_track() -> None:
    assert tuple(TRACK_WRITERS) == TRACK_FORMATS


def test_a_log_without_odometry_has_no_track(folder: Path, tmp_path: Path, capsys) -> None:
    assert main(["export", str(folder), "--format", "tum", "-o", str(tmp_path / "a.tum")]) == 2
    error = capsys.readouterr().err
    assert "holds no live odometry" in error and error.count("\n") == 1
