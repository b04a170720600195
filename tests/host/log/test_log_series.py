"""A series of logs: together they hold the messages of one log, and each is complete in itself."""

import errno
import itertools
import os
import shutil
import subprocess
from contextlib import contextmanager

import pytest

from fakes.traced_disk import TracedDisk
from hubodo.errors import InputError
from hubodo.log.disk_space import RotationRules
from hubodo.log.hubodo_messages import decode_bytes_message
from hubodo.log.log_series import MAX_PENDING_BYTES, LogSeries
from hubodo.log.log_writer import LogWriter
from hubodo.log.recording_reader import open_log, read_recording
from hubodo.log.recover import recover_log
from hubodo.recording import Event
from hubodo.units import NS_PER_S

T0 = 1_774_000_000 * NS_PER_S


class Clock:
    """A host clock set by the test."""

    def __init__(self):
        self.now = T0

    def __call__(self):
        return self.now


class RecordedSeries:
    """A recording into a series of logs, with a numbered incompressible message of 1 kB every 10 ms."""

    def __init__(self, out, rules, **options):
        self.clock = Clock()
        self.series = LogSeries(out, rules, self.clock, **options)
        self.log = LogWriter(self.series, t_zero_ns=T0, metadata={"a": "b"}, clock=self.clock)
        self.log.add_attachment("vehicle.toml", "application/toml", b"x = 1\n")
        self.numbers = itertools.count()

    def run(self, seconds):
        for _ in range(round(seconds * 100)):
            self.clock.now += NS_PER_S // 100
            payload = next(self.numbers).to_bytes(4, "little") + os.urandom(1000)
            self.log.write_raw_frame("usb0", self.clock.now, payload)
            self.log.tick()
            self.series.tick(self.clock.now)
        return self

    def close(self):
        self.log.close()
        return self.series


def message_numbers(*paths):
    """Return the numbers of the messages in these logs, in order; none of the logs has a warning."""
    values = []
    for path in paths:
        with open_log(path) as log:
            values += [
                int.from_bytes(decode_bytes_message("cdr", m.data)[:4], "little")
                for m in log.messages()
                if "/raw/" in m.topic
            ]
            assert log.warnings() == ()
    return values


def test_logs_rotated_by_time_hold_every_message_once_in_order_and_each_has_the_metadata(tmp_path):
    written = RecordedSeries(tmp_path / "drive.mcap", RotationRules(max_duration=10.0)).run(34.5)
    written.log.add_metadata("node.left", {"serial": "1"})
    series = written.run(10).close()
    assert [path.name for path in series.paths][:2] == [
        "drive-000001-20260320T094640Z.mcap",
        "drive-000002-20260320T094650Z.mcap",
    ]
    assert len(series.paths) == 5
    assert message_numbers(*series.paths) == list(range(4450))
    for path in series.paths:
        with open_log(path) as log:
            assert log.metadata_records["hubodo"]["a"] == "b"
            assert log.t_zero_ns == T0
            assert [file.name for file in log.scan.attachments] == ["vehicle.toml"]
            assert len(message_numbers(path)) > 400
    with open_log(series.paths[-1]) as log:
        assert log.metadata_records["node.left"] == {"serial": "1"}
    assert not series.has_losses
    assert series.size == sum(path.stat().st_size for path in series.paths)


def test_logs_rotated_by_size_stay_near_it_and_the_oldest_are_deleted_beyond_the_budget(tmp_path):
    keep = tmp_path / "drive-of-mine.mcap"
    keep.write_bytes(bytes(10))
    rules = RotationRules(max_size=200_000, budget=800_000)
    series = RecordedSeries(tmp_path / "drive.mcap", rules).run(40).close()
    left = [path for path in series.paths if path.exists()]
    assert series.disk_space.removed == len(series.paths) - len(left) > 10
    assert left == series.paths[-len(left) :]
    assert sum(path.stat().st_size for path in left) < 1_000_000
    assert max(path.stat().st_size for path in left) < 300_000
    values = message_numbers(*left)
    assert values == list(range(values[0], 4000))
    assert keep.exists()


def test_names_of_logs_have_a_number_and_a_time_and_are_unique(tmp_path):
    written = RecordedSeries(tmp_path, RotationRules())
    for _ in range(3):
        written.run(0.1)
        written.log.flush()
        written.series.rotate()
    paths = written.close().paths
    assert [path.name for path in paths] == [f"00000{k}-20260320T094640Z.mcap" for k in (1, 2, 3, 4)]
    assert written.series._names.existing_logs() == paths
    assert message_numbers(*paths) == list(range(30))


def test_with_a_clock_that_is_behind_the_oldest_logs_are_still_deleted_first(tmp_path):
    """Logs of an earlier version are followed by logs of a correct clock, then of one a year behind."""
    for name in (
        "drive-20260101T000000Z.mcap",
        "drive-20260101T000000Z-2.mcap",
        "drive-20990101T000000Z.mcap",
    ):
        (tmp_path / name).write_bytes(bytes(100_000))
    mine = tmp_path / "drive-by-the-sea.mcap"
    mine.write_bytes(bytes(10))
    rules = RotationRules(max_size=200_000, budget=800_000)
    earlier = RecordedSeries(tmp_path / "drive.mcap", rules).run(4).close()
    behind = RecordedSeries(tmp_path / "drive.mcap", rules)
    behind.clock.now -= 365 * 86_400 * NS_PER_S
    series = behind.run(30).close()
    left = [path for path in series.paths if path.exists()]
    assert len(left) >= 3
    assert left == series.paths[-len(left) :]
    assert set(tmp_path.iterdir()) == {*left, mine}
    assert [path.name.split("-")[1] for path in earlier.paths] == ["000001", "000002"]


@pytest.mark.parametrize("other", ["drive-000007-20260101T000000Z.mcap", "000007-20260101T000000Z.mcap"])
def test_recorders_with_other_names_in_one_folder_have_separate_numbers(tmp_path, other):
    (tmp_path / other).write_bytes(bytes(900_000))
    written = RecordedSeries(tmp_path / "left.mcap", RotationRules(max_size=200_000, budget=500_000)).run(10)
    assert written.close().paths[0].name.startswith("left-000001-")
    assert (tmp_path / other).exists()


def test_numbers_continue_in_a_folder_with_other_files(tmp_path):
    for name in ("000041-20260101T000000Z.mcap", "000042-20260101T000000Z.mcap.tmp", "000043-.mcap"):
        (tmp_path / name).write_bytes(b"")
    (tmp_path / f"{'9' * 30}-20260101T000000Z.mcap").write_bytes(b"")
    series = RecordedSeries(tmp_path, RotationRules(budget=10**9)).run(0.1).close()
    assert series.path.name == "000042-20260320T094640Z.mcap"


@pytest.mark.parametrize("size", [0, 5_000])
@pytest.mark.parametrize("rotates", [False, True])
def test_a_log_truncated_by_another_program_is_detected_within_a_second_and_the_next_starts(
    tmp_path, size, rotates
):
    written = RecordedSeries(
        tmp_path / "drive.mcap", RotationRules(max_duration=60.0 if rotates else None)
    ).run(3)
    first = written.series.path
    os.truncate(first, size)
    written.run(1)
    assert any("was shortened" in notice for notice in written.series.notices)
    assert written.series.path != first
    series = written.run(2).close()
    assert 250 < series.messages_lost < 400
    assert message_numbers(series.path) == list(range(series.messages_lost, 600))
    assert series.has_losses


@pytest.mark.parametrize("change", ["shortened", "deleted", "written to"])
def test_a_log_deleted_or_changed_just_before_its_end_is_counted_as_well(tmp_path, change):
    written = RecordedSeries(tmp_path / "drive.mcap", RotationRules()).run(3)
    path = written.series.path
    if change == "deleted":
        path.unlink()
    elif change == "shortened":
        os.truncate(path, 0)
    else:
        with path.open("ab") as another:
            another.write(b"another")
    series = written.close()
    assert series.messages_lost > 250
    assert any("messages in it are lost" in notice for notice in series.notices)


def test_an_existing_log_and_a_missing_folder_are_refused(tmp_path):
    (tmp_path / "log.mcap").write_bytes(b"precious")
    with pytest.raises(InputError, match="exists already"):
        LogSeries(tmp_path / "log.mcap", RotationRules(), Clock())
    with pytest.raises(InputError, match="folder does not exist"):
        LogSeries(tmp_path / "no" / "log.mcap", RotationRules(), Clock())


@contextmanager
def small_disk(folder, megabytes):
    """Mount a real file system of this size."""
    folder.mkdir()
    if os.geteuid() != 0 or shutil.which("mount") is None:
        pytest.skip("only root can mount a file system")
    written = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={megabytes}m", "tmpfs", folder], capture_output=True, text=True
    )
    if written.returncode:
        pytest.skip(f"no file system can be mounted here: {written.stderr.strip()}")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", folder], check=True)


@pytest.mark.parametrize("reserve", [0, 500_000])
def test_a_full_disk_pauses_the_log_and_free_space_starts_another(tmp_path, reserve):
    with small_disk(tmp_path / "disk", 4) as disk:
        ballast = disk / "ballast"
        ballast.write_bytes(bytes(3_000_000))
        written = RecordedSeries(disk / "drive.mcap", RotationRules(reserve=reserve)).run(14)
        assert not written.series.is_recording
        assert (
            "left on the disk" in written.series.pause_reason
            or "no space left" in written.series.pause_reason
        )
        until_full = message_numbers(disk / "drive.mcap") if reserve else None
        written.run(2)
        ballast.unlink()
        written.run(2)
        assert written.series.is_recording
        assert written.series.pause_reason is None
        series = written.close()
        values = message_numbers(*series.paths)
        assert len(series.paths) == 2
        assert "no longer" not in " ".join(series.notices)
        if reserve:
            assert values[: len(until_full)] == until_full
            assert values == list(range(1800)), "no message is lost while the buffer has room"
            assert not series.has_losses
        else:
            assert values == list(range(len(values)))
            assert len(values) + series.messages_lost == 1800


def test_data_that_cannot_be_written_is_buffered_up_to_a_limit_and_losses_are_counted(tmp_path):
    folder = tmp_path / "logs"
    folder.mkdir()
    written = RecordedSeries(folder / "drive.mcap", RotationRules()).run(1)
    shutil.rmtree(folder)
    written.run(1)
    assert "folder does not exist" in written.series.pause_reason
    written.run(200)
    assert sum(len(held.records) for held in written.series._pending) < MAX_PENDING_BYTES + 200_000
    folder.mkdir()
    series = written.run(1).close()
    values = message_numbers(series.path)
    assert values == list(range(20_300 - len(values), 20_300))
    assert len(values) * 1000 > 0.9 * MAX_PENDING_BYTES
    assert series.messages_lost == 20_300 - len(values)
    assert series.has_losses


@pytest.mark.parametrize("change", ["deleted", "replaced", "moved", "folder moved"])
def test_a_deleted_or_renamed_log_is_detected_within_a_second_and_recording_continues(tmp_path, change):
    folder = tmp_path / "logs"
    folder.mkdir()
    out = folder / "drive.mcap"
    written = RecordedSeries(out, RotationRules()).run(2)
    if change == "deleted":
        out.unlink()
    elif change == "replaced":
        out.unlink()
        out.write_bytes(b"another")
    elif change == "moved":
        out.rename(tmp_path / "mine.mcap")
    else:
        folder.rename(tmp_path / "older")
    written.run(1)
    assert written.series.notices
    notice = written.series.notices[0]
    if change == "folder moved":
        assert "was moved" in notice
        assert "folder does not exist" in written.series.pause_reason
        folder.mkdir()
        written.run(1)
    assert written.series.is_recording
    assert written.series.pause_reason is None
    series = written.run(2).close()
    lost = series.messages_lost
    if "moved" in change:
        mine = tmp_path / ("mine.mcap" if change == "moved" else "older/drive.mcap")
        assert lost == 0
        assert message_numbers(mine, series.path) == list(range(written.numbers.__next__()))
    else:
        assert "deleted or replaced" in notice
        assert 150 < lost < 300
        assert message_numbers(series.path) == list(range(lost, next(written.numbers)))
        assert series.has_losses
    if change == "replaced":
        assert out.read_bytes() == b"another"


@pytest.mark.parametrize("number", [errno.EROFS, errno.EIO, errno.EDQUOT])
def test_a_write_error_pauses_the_log_and_is_reported(tmp_path, number):
    written = RecordedSeries(tmp_path / "drive.mcap", RotationRules()).run(1)
    with TracedDisk() as disk:
        disk.refuses = number
        written.run(3)
        assert os.strerror(number).lower() in written.series.pause_reason
        assert not written.series.is_recording
    series = written.run(2).close()
    assert message_numbers(*series.paths) == list(range(600))
    assert len(series.paths) == 2


def test_at_the_file_size_limit_the_next_log_starts_and_the_first_stays_readable(tmp_path):
    """A memory card, for example, has a file system that limits files to 4 GB."""
    written = RecordedSeries(tmp_path / "drive.mcap", RotationRules())
    with TracedDisk() as disk:
        disk.largest_file = 300_000
        series = written.run(5).close()
    assert len(series.paths) == 2
    assert any("hubodo recover" in notice for notice in series.notices)
    whole = tmp_path / "whole.mcap"
    recover_log(series.paths[0], whole)
    assert message_numbers(whole, series.paths[1]) == list(range(500))


def test_a_power_cut_loses_at_most_five_seconds(tmp_path):
    """A cut may leave any prefix of the bytes written, at least up to the last sync."""
    with TracedDisk() as disk:
        written = RecordedSeries(tmp_path / "drive.mcap", RotationRules(max_duration=9.0))
        for _ in range(2000):
            written.run(0.01)
            disk.settle(written.series, written.clock.now)
        written.close()
    assert len(disk.moments) > 30
    worst = 0.0
    # The synced data stays constant until the next sync, just before which a cut loses most.
    for turn, ((_, safe), (t_ns, _)) in enumerate(itertools.pairwise(disk.moments)):
        values = []
        for k, (name, data) in enumerate(safe.items()):
            cut, whole = tmp_path / f"{turn}-{k}-{name}", tmp_path / f"{turn}-{k}-whole.mcap"
            cut.write_bytes(data)
            recover_log(cut, whole)
            values += message_numbers(whole)
        assert values == list(range(len(values)))
        worst = max(worst, (t_ns - T0) * 1e-9 - len(values) / 100)
    assert 1.0 < worst < 5.0


def test_a_disk_too_slow_for_that_guarantee_is_reported(tmp_path):
    with TracedDisk() as disk:
        disk.hang()
        written = RecordedSeries(tmp_path / "drive.mcap", RotationRules()).run(6)
        warnings = [notice for notice in written.series.notices if "power cut" in notice]
        disk.go_on()
        written.close()
    assert len(warnings) == 1


def test_a_repeated_event_keeps_its_time_and_does_not_lengthen_the_log(tmp_path):
    written = RecordedSeries(tmp_path / "drive.mcap", RotationRules())
    written.log.write_event(
        Event(T0 - 3600 * NS_PER_S, "started", "left", "long ago", {"power_on_ns": 1}), T0 + NS_PER_S
    )
    written.run(2).close()
    recording = read_recording(written.series.path)
    assert recording.events[0].t_ns == T0 - 3600 * NS_PER_S
    with open_log(written.series.path) as log:
        assert log.scan.chunks[0].start_ns > T0 - NS_PER_S
