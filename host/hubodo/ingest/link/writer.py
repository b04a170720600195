"""Writes to one open link from a thread of its own, so that a blocked write delays no other link."""

from __future__ import annotations

import queue
import threading
from dataclasses import dataclass, field

from hubodo.ingest.link.open_link import LinkDown, Transport

_MAX_WRITE_WAIT_S = 0.25
"""Longest wait for a write; longer than WRITE_TIMEOUT_S, after which a transport ends a write itself."""


@dataclass(slots=True, eq=False)
class _WriteJob:
    data: bytes
    to: str
    done: threading.Event = field(default_factory=threading.Event)
    is_written: bool = False


class LinkWriter:
    """The only writer of a transport, with a thread that starts with the first write.

    Sending a datagram does not block, so datagrams are written in the caller's thread.
    """

    def __init__(self, transport: Transport, label: str) -> None:
        self.error: Exception | None = None
        """Exception of the transport other than LinkDown."""
        self._transport = transport
        self._jobs: queue.SimpleQueue[_WriteJob | None] = queue.SimpleQueue()
        self._last: _WriteJob | None = None
        self._thread = threading.Thread(target=self._run, name=f"writer {label}", daemon=True)

    def write(self, data: bytes, to: str) -> bool:
        """Write and return True; return False when the write fails or takes longer than 0.25 s.

        While a write is blocked, further ones are refused at once.
        """
        if self.error is not None or (self._last is not None and not self._last.done.is_set()):
            return False
        job = _WriteJob(data, to)
        if self._transport.datagrams:
            self._write(job)
            return job.is_written
        if self._last is None:
            self._thread.start()
        self._last = job
        self._jobs.put(job)
        return job.done.wait(_MAX_WRITE_WAIT_S) and job.is_written

    def request_stop(self) -> None:
        """Let the thread end after the writes that wait."""
        self._jobs.put(None)

    def _run(self) -> None:
        while (job := self._jobs.get()) is not None:
            self._write(job)
            job.done.set()

    def _write(self, job: _WriteJob) -> None:
        try:
            self._transport.write(job.data, job.to)
            job.is_written = True
        except LinkDown:
            pass  # the reader gets the same error and reports it
        except Exception as error:  # noqa: BLE001 the reader reports it, and ends this attempt
            self.error = error
