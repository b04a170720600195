"""A recording over several files: nothing lost at the cut, each file whole and self-explaining."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hubodo.errors import InputError
from hubodo.log.mcap import open_log, read_recording
from hubodo.log.series import LogSeries


class Clock:
    """A clock turned by hand; it stands in for time.monotonic_ns."""

    now = 0

    def __call__(self) -> int:
        return self.now


def contents(paths: list[Path]) -> list[bytes]:
    found = []
    for path in paths:
        with open_log(path) as log:
            found += [message.data for message in log.messages()]
            assert log.warnings() == ()
            assert log.found.complete
    return found


@given(
    steps=st.lists(st.tuples(st.integers(0, 400_000_000), st.integers(0, 300)), min_size=1, max_size=60),
    max_bytes=st.none() | st.integers(1, 5000),
    max_s=st.none() | st.floats(0.01, 3),
)
def test_no_message_is_lost_or_doubled_at_the_cut(steps, max_bytes, max_s, tmp_path_factory) -> None:
    clock, path = Clock(), tmp_path_factory.mktemp("series") / "drive.mcap"
    written = []
    with LogSeries(path, max_bytes=max_bytes, max_s=max_s, clock=clock) as series:
        for i, (wait, size) in enumerate(steps):
            clock.now += wait
            written.append(i.to_bytes(4, "big") + bytes(size))
            series.log.raw("usb0", i, written[-1])
            series.tick()
    assert contents(series.paths) == written


def test_files_begin_anew_by_size_and_by_time(tmp_path: Path) -> None:
    clock = Clock()
    with LogSeries(tmp_path / "a.mcap", max_bytes=3000, clock=clock, compression="none") as by_size:
        for i in range(100):
            clock.now += 600_000_000
            by_size.log.raw("usb0", i, bytes(200))
            by_size.tick()
    assert [path.name for path in by_size.paths[:3]] == ["a-0000.mcap", "a-0001.mcap", "a-0002.mcap"]
    assert all(2000 < path.stat().st_size < 8000 for path in by_size.paths[:-1])
    with LogSeries(tmp_path / "b.mcap", max_s=10, clock=clock) as by_time:
        for i in range(100):
            clock.now += 1_000_000_000
            by_time.log.raw("usb0", i, b"")
            by_time.tick()
    assert [len(contents([path])) for path in by_time.paths] == [10] * 10 + [0]


def test_every_file_holds_metadata_attachments_and_the_same_t_zero(tmp_path: Path) -> None:
    def setup(log) -> None:
        log.attach("hubodo.toml", "application/toml", b"x = 1\n")

    with LogSeries(tmp_path / "a.mcap", metadata={"fingerprint": "abc"}, setup=setup) as series:
        for i in range(3):
            series.log.imu("left", series.log.t_zero_ns + i, 5, [[i, 0, 0]], [[0, 0, 0]])
            series.rotate()
    for i, path in enumerate(series.paths[:3]):
        recording = read_recording(path)
        assert recording.metadata["fingerprint"] == "abc"
        assert recording.metadata["series.number"] == str(i)
        assert recording.nodes["left"].t.tolist() == [i / 1e9]
        with open_log(path) as log:
            assert [a.data for a in log.found.attachments] == [b"x = 1\n"]


def test_a_series_that_exists_is_refused(tmp_path: Path) -> None:
    (tmp_path / "drive-0003.mcap").write_bytes(b"precious")
    with pytest.raises(InputError, match="this series exists already"):
        LogSeries(tmp_path / "drive.mcap")
    assert [path.name for path in tmp_path.iterdir()] == ["drive-0003.mcap"]
