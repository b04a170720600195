"""Recognition of logs written by hubodo."""

from types import SimpleNamespace

import pytest

from hubodo.log import topics
from hubodo.log.source import Stream, is_hubodo_log


@pytest.mark.parametrize(
    ("topic", "records", "expected"),
    [
        ("/imu", {}, False),
        ("/imu", {topics.METADATA_RECORD: {}}, True),
        ("/hubodo/events", {}, True),
        ("/hubodo_robot/imu", {"someone": {}}, False),
    ],
)
def test_a_log_of_hubodo_is_recognised_by_metadata_or_topics(topic, records, expected):
    streams = {1: Stream(1, topic, "sensor_msgs/msg/Imu", "cdr", {})}
    assert is_hubodo_log(SimpleNamespace(streams=streams, metadata_records=records)) is expected
