"""Suggestions for misspelt names of files."""

from pathlib import Path

import pytest

from hubodo.spelling import explain_missing_file, suggest_file


def test_a_missing_file_is_answered_by_the_one_that_was_meant(tmp_path: Path) -> None:
    for name in ("drive.mcap", "night.mcap", "notes.txt"):
        (tmp_path / name).touch()
    for missing in ("drive", "drive.csv"):
        assert suggest_file(tmp_path / missing) == f", did you mean {str(tmp_path / 'drive.mcap')!r}?"
    assert suggest_file(tmp_path / "nihgt.mcap") == f", did you mean {str(tmp_path / 'night.mcap')!r}?"
    assert suggest_file(tmp_path / "xyz.mcap") == suggest_file(tmp_path / "none" / "a.mcap") == ""
    assert suggest_file(tmp_path / "drive.mcap") == "", "an existing file that cannot be read"


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("s3://bucket/drive.mcap", "is a URL; `hubodo batch` reads it"),
        ("https://example.org/drive.mcap", "is a URL; download the file and name it"),
        ("file:///data/drive.mcap", "is a URL; give its path"),
        ("ros2:/left/imu", "is a port; `hubodo record` makes a log of it"),
        ("udp://0.0.0.0:47110", "is a port; `hubodo record` makes a log of it"),
    ],
)
def test_a_url_in_place_of_a_file_is_answered_by_what_reads_it(typed: str, meant: str) -> None:
    assert explain_missing_file(Path(typed), "no such file") == f"{typed}: {meant}"
