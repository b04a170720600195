"""Finding the logs of a batch."""

import os

import pytest

from hubodo.errors import InputError
from hubodo.fleet.listing import find_logs


@pytest.fixture
def drives(tmp_path):
    for name in ("van-1/a.mcap", "van-1/.hidden.mcap", "van-2/csv/left.csv", "van-2/bag/metadata.yaml",
                 "van-2/bag/bag_0.db3", "fused/fuse.json", "fused/track.csv", "out/b.mcap"):  # fmt: skip
        path = tmp_path / "drives" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(name)
    return tmp_path / "drives"


def test_files_csv_folders_and_bags_are_logs_but_hidden_files_results_and_output_are_not(drives):
    logs = find_logs([str(drives), f"{drives}/van-1/a*.mcap"], str(drives / "out"))
    assert [(log.url.removeprefix(f"{drives}/"), log.is_folder) for log in logs] == [
        ("van-1/a.mcap", False),
        ("van-2/bag", True),
        ("van-2/csv", True),
    ]
    assert [log.folder for log in logs] == ["van-1", "van-2", "van-2"]


def test_a_changed_log_has_another_stamp(drives):
    path = drives / "van-1" / "a.mcap"
    (before,) = find_logs([str(path)], str(drives / "out"))
    assert find_logs([str(path)], str(drives / "out")) == [before]
    os.utime(path, ns=(1, 1))
    (after,) = find_logs([str(path)], str(drives / "out"))
    assert (after.url, after.size) == (before.url, before.size) and after.stamp != before.stamp


@pytest.mark.parametrize(("source", "error"), [("absent", "does not exist"), ("fused", "no log in there")])
def test_a_source_without_logs_is_refused(source, error, drives):
    with pytest.raises(InputError, match=error):
        find_logs([str(drives / source)], str(drives / "out"))
