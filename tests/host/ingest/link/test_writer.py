"""Writes to a link from a thread of their own."""

import threading
import time

from hubodo.ingest.link.writer import LinkWriter


class Transport:
    datagrams = False

    def __init__(self, fault=None):
        self.sent, self.release, self.fault = [], threading.Event(), fault

    def write(self, data, to):
        if data == b"blocks":
            self.release.wait(300.0)
        if self.fault is not None:
            raise self.fault
        self.sent.append(data)


def test_a_blocked_write_returns_in_time_and_further_ones_are_refused_until_it_ends():
    transport = Transport()
    writer = LinkWriter(transport, "left")
    assert writer.write(b"first", "")
    start = time.monotonic()
    assert not writer.write(b"blocks", "") and not writer.write(b"refused", "")
    assert time.monotonic() - start < 100.0, "it waited for the blocked write"
    transport.release.set()
    deadline = time.monotonic() + 300.0
    while not writer.write(b"last", "") and time.monotonic() < deadline:
        time.sleep(0.01)
    assert transport.sent == [b"first", b"blocks", b"last"]
    writer.request_stop()


def test_an_exception_of_the_driver_is_stored_and_ends_the_writing():
    fault = RuntimeError("driver")
    writer = LinkWriter(Transport(fault), "left")
    assert not writer.write(b"x", "") and writer.error is fault
    assert not writer.write(b"y", "")
    writer.request_stop()
