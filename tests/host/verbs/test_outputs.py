"""The rule for existing outputs, shared by all verbs."""

import argparse
from pathlib import Path

import pytest

from hubodo.errors import InputError
from hubodo.verbs.outputs import add_force_option, replace_outputs


def parsed(*words: object) -> argparse.Namespace:
    """Return the arguments of a verb with an input and two outputs."""
    parser = argparse.ArgumentParser()
    parser.add_argument("log", type=Path)
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--report", type=Path)
    add_force_option(parser, "output", "report")
    return parser.parse_args([str(word) for word in words])


def test_an_existing_output_is_refused_without_force(tmp_path: Path) -> None:
    out = tmp_path / "out.mcap"
    out.write_text("old")
    with (
        pytest.raises(InputError, match=r"exists already.*--force"),
        replace_outputs(parsed("log", "-o", out)),
    ):
        pytest.fail("the verb ran")
    assert out.read_text() == "old"


def test_with_force_the_verb_finds_no_file_and_a_failure_brings_the_earlier_one_back(tmp_path: Path) -> None:
    out = tmp_path / "out.mcap"
    out.write_text("old")
    with pytest.raises(ValueError, match="failed"), replace_outputs(parsed("log", "-o", out, "--force")):
        assert not out.exists()
        raise ValueError("failed")
    assert out.read_text() == "old"
    with replace_outputs(parsed("log", "-o", out, "--force")):
        out.write_text("new")
    assert out.read_text() == "new"
    assert list(tmp_path.iterdir()) == [out]


def test_the_input_and_a_folder_with_other_files_are_never_replaced(tmp_path: Path) -> None:
    log = tmp_path / "folder" / "left.csv"
    log.parent.mkdir()
    log.write_text("t\n")
    for arguments, problem in (
        ((log, "-o", log), "is or holds the input"),
        ((log, "-o", log.parent), "is or holds the input"),
        (("log", "-o", tmp_path), "did not write"),
    ):
        with pytest.raises(InputError, match=problem), replace_outputs(parsed(*arguments, "--force")):
            pytest.fail("the verb ran")
    assert log.read_text() == "t\n"


def test_devices_and_empty_folders_are_free(tmp_path: Path) -> None:
    with replace_outputs(parsed("log", "-o", tmp_path, "--report", "/dev/null")):
        pass
