"""Free disk space and the budget of a recording."""

import pytest

from hubodo.log.disk_space import DiskSpace, RotationRules
from hubodo.log.log_names import LogNames


@pytest.fixture
def logs(tmp_path):
    paths = [tmp_path / f"drive-{n:06d}-20260401T09300{n}Z.mcap" for n in range(1, 6)]
    for path in paths:
        path.write_bytes(bytes(1000))
    return paths


def test_the_oldest_unused_logs_are_removed_until_the_budget_holds(logs, tmp_path):
    reports = []
    space = DiskSpace(LogNames(tmp_path / "drive.mcap", plain=False), 3000, reports.append)
    space.enforce_budget([logs[0]], expected=500)
    assert [path.exists() for path in logs] == [True, False, False, False, True]
    assert space.removed == len(reports) == 3 and logs[1].name in reports[0]


def test_without_a_budget_nothing_is_removed_even_on_a_full_disk(logs, tmp_path):
    space = DiskSpace(LogNames(tmp_path / "drive.mcap", plain=False), None, pytest.fail)
    space.enforce_budget([])
    space.make_room(1 << 62, [])
    assert all(path.exists() for path in logs)
    assert space.describe_shortage(0) is None and "MB are left" in space.describe_shortage(1 << 62)


def test_a_recording_rotates_by_duration_or_size():
    assert not RotationRules().is_rotating
    assert RotationRules(max_duration=1.0).is_rotating and RotationRules(max_size=1).is_rotating
