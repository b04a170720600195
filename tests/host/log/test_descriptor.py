"""Files by descriptor."""

import os

import pytest

from hubodo.log import descriptor


def test_a_file_truncated_by_another_program_gets_no_hole(tmp_path):
    path = tmp_path / "x"
    fd = descriptor.create_append_only(path)
    os.write(fd, b"0123456789")
    os.truncate(path, 3)
    os.write(fd, b"abc")
    os.close(fd)
    assert path.read_bytes() == b"012abc"
    with pytest.raises(FileExistsError):
        descriptor.create_append_only(path)


def test_the_replacement_of_pread_reads_the_same(tmp_path):
    (tmp_path / "x").write_bytes(bytes(range(100)))
    fd = descriptor.open_read_only(tmp_path / "x")
    try:
        for size, offset in ((10, 50), (50, 80), (5, 200)):
            assert descriptor._seek_and_read(fd, size, offset) == os.pread(fd, size, offset)
    finally:
        os.close(fd)
