"""Files are written completely or not at all, and existing files are not replaced unless requested."""

import pytest

from hubodo.atomic_files import (
    atomic_files,
    atomic_folder,
    atomic_new_file,
    require_free_path,
    write_atomically,
)
from hubodo.errors import InputError


def test_files_appear_together_when_the_block_succeeds(tmp_path):
    first, second = tmp_path / "new" / "a", tmp_path / "new" / "b"
    with atomic_files(first, second, create_folder=True) as parts:
        for part in parts:
            part.write_text(part.name)
        assert not first.exists() and not second.exists()
    assert (first.read_text(), second.read_text()) == ("a", "b")
    assert sorted(path.name for path in first.parent.iterdir()) == ["a", "b"]


def test_after_a_failure_the_old_file_remains_and_a_created_folder_is_removed(tmp_path):
    write_atomically(tmp_path / "a", "old")
    for path in (tmp_path / "a", tmp_path / "new" / "b"):
        with pytest.raises(RuntimeError), atomic_files(path, create_folder=True) as (part,):
            part.write_text("half")
            raise RuntimeError
    assert (tmp_path / "a").read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_an_existing_path_is_not_free(tmp_path):
    (tmp_path / "a").write_text("")
    with pytest.raises(InputError, match="exists already"):
        require_free_path(tmp_path / "a")
    with pytest.raises(InputError, match="its folder does not exist"):
        require_free_path(tmp_path / "no" / "a")
    with pytest.raises(InputError, match="exists already"), atomic_new_file(tmp_path / "a"):
        pass
    with pytest.raises(InputError, match="is not empty"), atomic_folder(tmp_path):
        pass


def test_a_file_created_by_others_while_writing_is_not_replaced(tmp_path):
    with pytest.raises(InputError, match="exists already"), atomic_new_file(tmp_path / "a") as part:
        part.write_text("ours")
        (tmp_path / "a").write_text("theirs")
    assert (tmp_path / "a").read_text() == "theirs"
