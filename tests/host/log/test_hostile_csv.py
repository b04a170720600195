"""Hostile CSV folders: decompression bombs, endless rows, FIFOs, thousands of digits and columns."""

import gzip
import os
from pathlib import Path

import pytest

from hubodo.log import csv_table
from hubodo.log.csv_header import MAX_COLUMNS, MAX_LINE_BYTES
from in_process import hubodo

HEAD = b"t,gx,gy,gz,ax,ay,az\n"
ROWS = b"".join(b"%d,1,2,3,4,5,6\n" % i for i in range(2000))


def refusal(folder: Path, *options: object) -> str:
    done = hubodo("info", folder, *options)
    assert (done.code, done.err.count("\n"), done.out) == (2, 1, ""), done.err
    assert len(done.err) < 700
    return done.err


def log(folder: Path, data: bytes, *, packed: bool = False) -> Path:
    log_folder = folder / "log"
    log_folder.mkdir()
    if packed:
        (log_folder / "left.csv.gz").write_bytes(gzip.compress(data))
    else:
        (log_folder / "left.csv").write_bytes(data)
    return log_folder


def test_rows_stay_within_the_memory_limit(tmp_path):
    folder = log(tmp_path, HEAD + ROWS)
    assert "left.csv: the table needs 336000 bytes of memory, the limit is 300000 bytes" in refusal(
        folder, "--max-memory", 0.3
    )
    assert hubodo("export", folder, "-o", tmp_path / "out", "--max-memory", 0.4).code == 0


def test_a_gzipped_file_expands_only_up_to_the_limit_of_its_size(tmp_path, monkeypatch):
    monkeypatch.setattr(csv_table, "_MIN_EXPANDED_BYTES", 50_000)
    bomb = HEAD + ROWS + b"# nothing\n" * 2_000_000
    assert "MB of room, the most for a file of its size is" in refusal(log(tmp_path, bomb, packed=True))


@pytest.mark.parametrize("where", ["header", "rows"])
def test_an_endless_line_is_refused_before_it_fills_memory(where, tmp_path):
    data = (b"" if where == "header" else HEAD) + b"0" * (8 * MAX_LINE_BYTES)
    words = "no header" if where == "header" else f"a row is longer than {MAX_LINE_BYTES} bytes"
    assert words in refusal(log(tmp_path, data, packed=True))


def test_a_file_of_comments_is_refused(tmp_path):
    assert "row 10001: no header" in refusal(log(tmp_path, b"#\n" * 20_000 + HEAD + ROWS))


def test_a_cell_of_thousands_of_digits_is_refused_in_a_short_line(tmp_path):
    assert "row 2: NaN or infinity: gz is '99" in refusal(
        log(tmp_path, HEAD + b"0,1,2,%s,4,5,6\n" % (b"9" * 5000))
    )


def test_the_number_of_columns_is_limited_and_a_repeated_one_refused(tmp_path):
    names = HEAD[:-1] + b"".join(b",c%d" % i for i in range(100_000))
    assert f"{MAX_COLUMNS} at most" in refusal(log(tmp_path, names + b"\n"))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no FIFO")
def test_a_fifo_in_a_folder_is_refused(tmp_path):
    folder = log(tmp_path, HEAD + ROWS)
    os.mkfifo(folder / "right.csv")
    assert "right.csv: is not a regular file" in refusal(folder)
