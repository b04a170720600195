"""Pauses between attempts to open a link."""

from hubodo.ingest.link.retry import Backoff, ValidityCheck
from hubodo.units import NS_PER_S
from hubowire import Frame, encode_frame


def test_pauses_double_to_one_second_for_an_absent_device_and_to_eight_for_useless_connections():
    absent, useless = Backoff(), Backoff()
    assert absent.is_first
    assert [absent.pause_after_failed_open() for _ in range(6)] == [0.1, 0.2, 0.4, 0.8, 1.0, 1.0]
    assert not absent.is_first
    pauses = [useless.pause_after_loss(was_valid=False) for _ in range(9)]
    assert pauses == [0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 8.0, 8.0]
    assert useless.pause_after_loss(was_valid=True) == 0.05


def test_a_frame_or_a_sentence_in_pieces_or_ten_seconds_make_a_connection_valid():
    frame = encode_frame(Frame(1, 1, 0, b"12345678"))
    for data in (frame, b"noise\r\n$GPTXT,1*52\r\n"):
        check = ValidityCheck(0)
        for k in range(len(data)):
            check.feed(data[k : k + 1])
        assert check.is_valid(0)
    silent = ValidityCheck(0)
    silent.feed(frame[:-3])
    assert not silent.is_valid(9 * NS_PER_S) and silent.is_valid(10 * NS_PER_S)
