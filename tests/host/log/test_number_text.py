"""Numbers in rows of text."""

import gzip

import numpy as np
import pytest

from hubodo.errors import InputError
from hubodo.log.number_text import read_text_table


@pytest.mark.parametrize("delimiter", [",", ";", "\t", " "])
def test_the_delimiter_is_detected_and_comments_are_skipped(delimiter, tmp_path):
    rows = [["t", "gz"], ["0", "1e-3"], ["1", "nan"]]
    text = "# a comment\n\n" + "\n".join(delimiter.join(row) for row in rows) + "\n% the end\n"
    (tmp_path / "x.txt").write_bytes(gzip.compress(text.encode()))
    values, names = read_text_table(tmp_path / "x.txt")
    assert names == ("t", "gz")
    np.testing.assert_array_equal(values, [[0, 1e-3], [1, np.nan]])


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("1,2\n3\n", "row 2 has 1 columns, the first 2"),
        ("1,2\n\n3,x\n", "row 3: 'x' is not a number"),
        ("a,b\n", "no row below the header"),
        ("", "holds no numbers"),
    ],
)
def test_the_first_malformed_row_is_named(text, error, tmp_path):
    (tmp_path / "x.txt").write_text(text)
    with pytest.raises(InputError, match=error):
        read_text_table(tmp_path / "x.txt")
