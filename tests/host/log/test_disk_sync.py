"""Syncing of files to disk from a thread."""

import os

import pytest

from hubodo.log.disk_sync import Syncer, sync_folder
from waiting import until


def test_a_synced_descriptor_is_closed_and_an_error_reported_once(tmp_path):
    syncer = Syncer()
    fd = os.open(tmp_path / "x", os.O_CREAT | os.O_WRONLY)
    pipe, other_end = os.pipe()  # a pipe cannot be synced
    syncer.enqueue(fd)
    syncer.enqueue(pipe)
    until(lambda: not syncer.is_busy)
    for closed in (fd, pipe):
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.fstat(closed)
    os.close(other_end)
    assert syncer.pop_error() and syncer.pop_error() is None
    assert syncer.close(60.0)
    sync_folder(tmp_path / "absent")  # does not raise
