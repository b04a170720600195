"""Rosbag2 folders compressed by file or by message."""

import pytest
import zstandard

from hubodo.errors import InputError
from hubodo.log.compressed_bag import StorageFiles, make_message_expander, read_compression_mode


@pytest.mark.parametrize(
    ("line", "mode"),
    [
        ("compression_mode: FILE", "file"),
        ("compression_mode: 'message'", "message"),
        ("compression_mode: ''", ""),
    ],
)
def test_the_compression_mode_is_read_from_the_metadata(line, mode, tmp_path):
    (tmp_path / "metadata.yaml").write_text(f"rosbag2_bagfile_information:\n  {line}\n")
    assert read_compression_mode(tmp_path / "metadata.yaml") == mode
    assert read_compression_mode(tmp_path / "absent.yaml") == ""


def test_compressed_files_are_expanded_until_they_are_closed(tmp_path):
    (tmp_path / "bag_0.db3.zstd").write_bytes(zstandard.compress(b"content"))
    files = StorageFiles(tmp_path)
    (database,) = files.databases
    assert database.read_bytes() == b"content"
    files.close()
    assert not database.exists()


def test_a_damaged_file_or_message_is_refused(tmp_path):
    (tmp_path / "bag_0.db3.zstd").write_bytes(b"\x28\xb5\x2f\xfd broken")
    with pytest.raises(InputError, match="does not decompress"):
        StorageFiles(tmp_path)
    expand = make_message_expander(tmp_path)
    assert expand(zstandard.compress(b"message")) == b"message"
    with pytest.raises(ValueError, match="does not decompress"):
        expand(b"message")
