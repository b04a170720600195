"""Names of the logs of a recording."""

import pytest

from hubodo.errors import InputError
from hubodo.log.log_names import LogNames

T = 1_775_035_800_000_000_000  # 2026-04-01 09:30:00 UTC


def test_the_number_orders_the_logs_even_if_the_clock_is_behind(tmp_path):
    names = LogNames(tmp_path / "drive.mcap", plain=False)
    for t_ns in (T, T - 10**15, T):
        names.next_path(t_ns).touch()
    (tmp_path / "drive-20200101T000000Z.mcap").touch()  # of an earlier version, without a number
    (tmp_path / "other-000009-20260401T093000Z.mcap").touch()
    assert [path.name for path in names.existing_logs()] == [
        "drive-20200101T000000Z.mcap",
        "drive-000001-20260401T093000Z.mcap",
        "drive-000002-20260320T194320Z.mcap",
        "drive-000003-20260401T093000Z.mcap",
    ]


def test_a_single_log_has_the_plain_name_which_must_be_free(tmp_path):
    names = LogNames(tmp_path / "drive.mcap", plain=True)
    assert names.next_path(T) == tmp_path / "drive.mcap"
    (tmp_path / "drive.mcap").touch()
    assert names.next_path(T).name == "drive-000001-20260401T093000Z.mcap"
    with pytest.raises(InputError, match="exists already"):
        LogNames(tmp_path / "drive.mcap", plain=True)
