"""The sink that writes the log and passes records on."""

from hubodo.ingest.live.bulkheads import Bulkheads
from hubodo.ingest.live.tee_sink import TeeSink
from hubodo.log.records import Metadata, RawFrame, stream_key


class Log:
    def __init__(self):
        self.records = []

    def write_record(self, record):
        self.records.append(record)


def test_each_record_is_written_first_and_a_listener_that_raises_affects_no_other():
    log, received, now = Log(), [], [0]

    def raising(record):
        raise RuntimeError("listener")

    def receive(record):
        assert log.records[-1] is record
        received.append(record)

    bulkheads = Bulkheads(lambda: now[0])
    sink = TeeSink(log, {"broken": raising, "page": receive}, bulkheads)
    records = [RawFrame("left", 1, b"x"), Metadata("clock", {"state": "unset"})]
    for record in records:
        sink.write_record(record)
    assert log.records == received == records
    assert bulkheads.fault_counts() == {"broken": 1}, "it is suspended after its first fault"


def test_records_of_one_channel_share_a_key_and_others_do_not():
    keys = [stream_key(RawFrame(link, t, b"")) for link, t in (("left", 1), ("left", 2), ("right", 1))]
    assert keys[0] == keys[1] != keys[2]
