"""Rosbags as a source of messages."""

from pathlib import Path

import pytest

from hubodo.errors import InputError
from hubodo.log.bag import Bag, open_bag
from hubodo.log.source import FileInfo, Stream

STREAM = Stream(1, "/imu", "sensor_msgs/msg/Imu", "cdr", {})


def bag(rows, count):
    return Bag(Path("x.bag"), FileInfo(100, "rosbag", "ros1", True), [STREAM], rows, count)


def test_messages_before_damage_are_read_and_the_lost_ones_counted():
    def rows():
        for k in range(5):
            yield 1, 1000 * k, bytes([k])
        raise OSError("unreadable page")

    source = bag(rows, 12)
    (messages,) = source.chunks()
    assert [messages.payload(k) for k in range(5)] == [bytes([k]) for k in range(5)]
    assert messages.headers["log_time"].tolist() == [0, 1000, 2000, 3000, 4000]
    assert "5 of 12 messages are kept" in source.warnings()[0]
    assert source.file_info.damaged == 1 and source.progress == pytest.approx(5 / 12)


def test_a_second_pass_starts_from_the_beginning():
    source = bag(lambda: iter([(1, 5, b"x"), (1, 6, b"y")]), 2)
    for _ in range(2):
        assert sum(len(messages.offsets) for messages in source.chunks()) == 2
    assert source.warnings() == ()


def test_a_folder_without_messages_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"neither an \.mcap nor a \.db3 file"):
        open_bag(tmp_path)
