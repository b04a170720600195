"""Ports with any descriptor number can be read."""

import fcntl
import os
import resource
import select

import pytest

from hubodo.ingest.readiness import can_read, can_write


@pytest.fixture
def high_pipe():
    """Return a pipe whose descriptors are beyond the limit of `select`."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(4096, hard), hard))
    low = os.pipe()
    high = [fcntl.fcntl(descriptor, fcntl.F_DUPFD, 1500) for descriptor in low]
    yield high
    for descriptor in (*low, *high):
        os.close(descriptor)
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_a_descriptor_beyond_those_of_select_is_waited_for(high_pipe):
    reading, writing = high_pipe
    with pytest.raises(ValueError, match="out of range"):
        select.select([reading], [], [], 0)
    assert not can_read(reading, 0.0)
    assert can_write(writing, 0.0)
    os.write(writing, b"x")
    assert can_read(reading, 0.0)


def test_the_end_of_a_stream_can_be_read(high_pipe):
    reading, writing = os.pipe()
    os.close(writing)
    assert can_read(reading, 0.0)
    os.close(reading)
