"""Numbers in rows of text."""

import gzip

import numpy as np
import pytest

from hubodo.errors import InputError
from hubodo.log.number_file import detect_file_kind
from hubodo.log.number_text import read_text_table


@pytest.mark.parametrize("delimiter", [",", ";", "\t", " "])
def test_the_delimiter_is_detected_and_comments_are_skipped(delimiter, tmp_path):
    rows = [["t", "gz"], ["0", "1e-3"], ["1", "nan"]]
    text = "# a comment\n\n" + "\n".join(delimiter.join(row) for row in rows) + "\n% the end\n"
    (tmp_path / "x.txt").write_bytes(gzip.compress(text.encode()))
    values, names, notes = read_text_table(tmp_path / "x.txt")
    assert names == ("t", "gz") and not notes
    np.testing.assert_array_equal(values, [[0, 1e-3], [1, np.nan]])


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("1,2\n3\n", "row 2 has 1 columns, the first 2"),
        ("1,2\n\n3,x\n", "row 3: 'x' is not a number"),
        ("1,2\n3\n4,5", "row 2 has 1 columns, the first 2"),
        ("a,b\n", "no row below the header"),
        ("", "holds no numbers"),
    ],
)
def test_the_first_malformed_row_is_named(text, error, tmp_path):
    (tmp_path / "x.txt").write_text(text)
    with pytest.raises(InputError, match=error):
        read_text_table(tmp_path / "x.txt")


NUMBERS = [[0.0, 1.0], [1.0, 2.0], [2.0, 3.0]]


@pytest.mark.parametrize(
    "text",
    [
        "t,gz,\n0,1,\n1,2,\n2,3,\n",
        "t,gz\n0,1,\n1,2,\n2,3,\n",
        "Device,Logger\nSerial,12\nStart,2026-11-27 10:00\n\nt,gz,mark\n0,1,0\n1,2,0\n2,3,0\n",
        '\ufeff"t";"gz"\r\n"0,0";"1,0"\r\n"1,0";"2,0"\r\n"2,0";"3,0"\r\n',
    ],
    ids=["trailing commas", "below the header only", "preamble with values", "quoted decimal commas"],
)
def test_rows_as_other_programs_write_them_are_read(text, tmp_path):
    (tmp_path / "x.csv").write_text(text, "utf-8")
    values, names, notes = read_text_table(tmp_path / "x.csv")
    assert [name for name in names if name][:2] == ["t", "gz"] and not notes
    np.testing.assert_array_equal(values[:, :2], NUMBERS)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be"])
def test_utf_16_is_read_with_and_without_its_mark(encoding, tmp_path):
    (tmp_path / "x.csv").write_bytes("t,gz\n0,1\n1,2\n2,3\n".encode(encoding))
    assert detect_file_kind(tmp_path / "x.csv") == "text"
    np.testing.assert_array_equal(read_text_table(tmp_path / "x.csv")[0], NUMBERS)


@pytest.mark.parametrize("cell", ["", "n/a", "NaN", "NULL", "-"])
@pytest.mark.parametrize("row", [0, 2])
def test_a_missing_number_is_nan_in_whichever_row(cell, row, tmp_path):
    rows = [["0", "1"], ["1", "2"], ["2", "3"]]
    rows[row][1] = cell
    (tmp_path / "x.csv").write_text("t,gz\n" + "\n".join(map(",".join, rows)) + "\n")
    values, _, _ = read_text_table(tmp_path / "x.csv")
    expected = np.array(NUMBERS)
    expected[row, 1] = np.nan
    np.testing.assert_array_equal(values, expected)


def test_a_last_row_that_was_cut_off_is_left_out_and_named(tmp_path):
    (tmp_path / "x.csv").write_text("t,gz\n0,1\n1,2\n2,3\n3")
    values, _, notes = read_text_table(tmp_path / "x.csv")
    np.testing.assert_array_equal(values, NUMBERS)
    assert len(notes) == 1 and "row 5, the last one, has 1 of 2 columns; left out" in notes[0]
