"""The examination of one log of a batch."""

from pathlib import Path

import pytest

from hubodo.errors import InputError
from hubodo.fleet.listing import LogLocation
from hubodo.fleet.task import DONE, FAILED, KNOWN, REFUSED, Analysis, examine_log


def examine(tmp_path, run, known_keys=frozenset(), **options):
    (tmp_path / "a.csv").write_text("t,gx\n")
    location = LogLocation(str(tmp_path / "a.csv"), 5, "stamp")
    analysis = Analysis("report", options, {}, run)
    return examine_log(location, analysis, known_keys, str(tmp_path / "out"))


def test_files_of_a_verb_are_stored_and_its_result_is_extracted(tmp_path):
    def run(verb, options, log, folder):
        (folder / "page.html").write_text("page")
        return {"log": str(log), "size": 4, "missing": ["gap"], "output": str(folder)}

    row = examine(tmp_path, run)
    assert row["status"] == DONE, row.get("error")
    assert (tmp_path / "out" / row["files"] / "page.html").read_text() == "page"
    assert {item["quantity"]: item["value"] for item in row["quantities"]} == {"page": 4, "not_shown": 1}
    assert examine(tmp_path, run, frozenset({row["key"]}))["status"] == KNOWN


@pytest.mark.parametrize(
    ("error", "status", "text"),
    [
        (InputError("x: is empty;\nremove it"), REFUSED, "x: is empty; remove it"),
        (MemoryError(), FAILED, "not enough memory"),
        (ZeroDivisionError("a defect"), FAILED, "ZeroDivisionError: a defect"),
    ],
)
def test_an_error_is_one_line_in_the_row_with_its_retry_flag(error, status, text, tmp_path):
    def run(*_):
        raise error

    row = examine(tmp_path, run)
    assert row["status"] == status and text in row["error"]


def test_the_key_depends_on_options_and_the_content_of_their_files_but_not_on_their_place():
    digests = {
        Analysis("gap", {"model": Path(path), "seed": seed}, {path: content}, print).digest
        for path, content, seed in (("/a/m.toml", b"1", 1), ("/b/m.toml", b"1", 1))
    }
    assert len(digests) == 1
    assert (
        Analysis("gap", {"model": Path("/a/m.toml"), "seed": 1}, {"/a/m.toml": b"2"}, print).digest
        not in digests
    )
    assert (
        Analysis("gap", {"model": Path("/a/m.toml"), "seed": 2}, {"/a/m.toml": b"1"}, print).digest
        not in digests
    )
