"""Suggestions for misspelt names of files."""

from pathlib import Path

from hubodo.spelling import suggest_file


def test_a_missing_file_is_answered_by_the_one_that_was_meant(tmp_path: Path) -> None:
    for name in ("drive.mcap", "night.mcap", "notes.txt"):
        (tmp_path / name).touch()
    for missing in ("drive", "drive.csv"):
        assert suggest_file(tmp_path / missing) == f", did you mean {str(tmp_path / 'drive.mcap')!r}?"
    assert suggest_file(tmp_path / "nihgt.mcap") == f", did you mean {str(tmp_path / 'night.mcap')!r}?"
    assert suggest_file(tmp_path / "xyz.mcap") == suggest_file(tmp_path / "none" / "a.mcap") == ""
    assert "`hubodo batch` reads it" in suggest_file(Path("s3://bucket/drive.mcap"))
    assert "download it first" in suggest_file(Path("https://example.org/drive.mcap"))
    assert suggest_file(tmp_path / "drive.mcap") == "", "an existing file that cannot be read"
