"""`hubodo recover` as a user runs it."""

import json
from pathlib import Path

import numpy as np
import pytest

from hubodo.cli import main
from hubodo.log.log_writer import LogWriter


@pytest.fixture
def cut(tmp_path: Path) -> Path:
    """Write a recording of 300 samples and cut it in its second half."""
    with LogWriter(tmp_path / "log.mcap", t_zero_ns=0, chunk_bytes=4000, clock=None) as log:
        for i in range(0, 300, 5):
            t = np.arange(i, i + 5) * 10_000_000
            log.write_imu("left", t, t, np.ones((5, 3)), np.ones((5, 3)))
    path = tmp_path / "cut.mcap"
    data = (tmp_path / "log.mcap").read_bytes()
    path.write_bytes(data[: len(data) * 2 // 3])
    return path


def test_the_report_agrees_with_info_on_the_new_log(cut: Path, tmp_path: Path, capsys) -> None:
    assert main(["recover", str(cut), "-o", str(tmp_path / "new.mcap"), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert main(["info", str(tmp_path / "new.mcap"), "--json"]) == 0
    info = json.loads(capsys.readouterr().out)
    assert {s["topic"]: s["messages"] for s in info["streams"]} == report["messages"]
    assert info["complete"] is True
    assert info["warnings"] == []
    assert report["was_whole"] is False
    assert report["bytes_lost"] > 0
    assert 100 < report["messages"]["/left/imu"] < 300


def test_the_text_output_names_recovered_and_lost_data(cut: Path, tmp_path: Path, capsys) -> None:
    assert main(["recover", str(cut), "-o", str(tmp_path / "new.mcap")]) == 0
    text = capsys.readouterr().out
    assert "/left/imu: recovered" in text
    assert "recovered t = 0.000 s to" in text
    assert "bytes at the end are lost" in text


def test_a_complete_log_needs_no_repair(cut: Path, tmp_path: Path, capsys) -> None:
    assert main(["recover", str(tmp_path / "log.mcap"), "-o", str(tmp_path / "new.mcap")]) == 0
    assert "nothing had to be repaired" in capsys.readouterr().out


def test_an_existing_output_or_a_foreign_input_exits_2_with_one_line(
    cut: Path, tmp_path: Path, capsys
) -> None:
    assert main(["recover", str(cut), "-o", str(tmp_path / "log.mcap")]) == 2
    assert "exists already" in capsys.readouterr().err
    (tmp_path / "song.mp3").write_bytes(b"ID3" + bytes(5000))
    assert main(["recover", str(tmp_path / "song.mp3"), "-o", str(tmp_path / "new.mcap")]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "is not an MCAP file" in err
    assert not (tmp_path / "new.mcap").exists()
