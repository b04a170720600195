"""Files by path or URL."""

import pytest

from hubodo.errors import InputError, LinkError
from hubodo.fleet.storage import format_url, open_file_system, report_store_errors, write_atomically


@pytest.mark.parametrize("root", ["local", "memory://fleet"])
def test_a_file_is_written_and_replaced_in_a_folder_or_a_store(root, tmp_path):
    fs, path = open_file_system(str(tmp_path / root) if root == "local" else root)
    for content in (b"first", b"second"):
        write_atomically(fs, f"{path}/a/b.txt", content)
        assert fs.cat_file(f"{path}/a/b.txt") == content
    assert [name.rpartition("/")[2] for name in fs.find(path)] == ["b.txt"]


def test_urls_keep_their_protocol_and_paths_do_not_get_one(tmp_path):
    assert format_url(*open_file_system("memory://fleet/x")).startswith("memory://")
    assert format_url(*open_file_system(str(tmp_path))) == str(tmp_path)


def test_an_unknown_protocol_and_an_error_of_a_store_are_one_line_each():
    with pytest.raises(InputError, match="nonesuch"):
        open_file_system("nonesuch://x")
    with (
        pytest.raises(LinkError, match=r"s3://x: KeyError: .*check the address"),
        report_store_errors("s3://x"),
    ):
        raise KeyError("two\nlines")
