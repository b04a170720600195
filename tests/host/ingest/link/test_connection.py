"""Events of a port that opens and closes."""

from hubodo.ingest.link.connection import Connection
from hubodo.ingest.link.link import LinkLost, LinkUp
from hubodo.log.records import EventRecord
from hubodo.units import NS_PER_S


class Sink:
    def __init__(self):
        self.kinds = []

    def write_record(self, record):
        assert isinstance(record, EventRecord)
        self.kinds.append(record.event.kind)


def test_a_port_that_opens_and_fails_each_second_is_reported_less_and_less():
    sink = Sink()
    connection = Connection("left", sink)
    for t in range(100):
        connection.handle_up(LinkUp("left", t * NS_PER_S, "/dev/left", False))
        connection.handle_lost(LinkLost("left", t * NS_PER_S + 1, "gone"))
    assert connection.disconnections == 100
    assert sink.kinds.count("disconnected") == 4


def test_a_loss_after_valid_data_is_reported_at_once():
    sink = Sink()
    connection = Connection("left", sink)
    for t in range(5):
        connection.handle_up(LinkUp("left", t * NS_PER_S, "/dev/left", False))
        connection.mark_valid()
        connection.handle_lost(LinkLost("left", t * NS_PER_S + 1, "gone"))
    assert sink.kinds == ["connected", "disconnected"] * 5
    assert len(connection.take_notices()) == 9 and connection.take_notices() == []
