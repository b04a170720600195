"""Writes to one open link, where it can hang from a thread of its own that holds up no other link."""

from __future__ import annotations

import queue
import threading
from dataclasses import dataclass, field

from hubodo.ingest.link.open_link import LinkDown, Transport

_MAX_WRITE_WAIT_S = 0.25
"""Transports give up after 0.1 s by themselves."""


@dataclass(slots=True, eq=False)
class _WriteJob:
    data: bytes
    to: str
    done: threading.Event = field(default_factory=threading.Event)
    is_written: bool = False


class LinkWriter:
    """The only one who writes to a transport, in a thread that begins with the first write.

    Datagrams leave at once or not at all, so they are written in the caller's thread.
    """

    def __init__(self, transport: Transport, label: str) -> None:
        self.error: Exception | None = None
        """What the transport raised, other than that the link is down."""
        self._transport = transport
        self._jobs: queue.SimpleQueue[_WriteJob | None] = queue.SimpleQueue()
        self._last: _WriteJob | None = None
        self._thread = threading.Thread(target=self._run, name=f"writer {label}", daemon=True)

    def write(self, data: bytes, to: str) -> bool:
        """Write and return True once that is done; False when it failed, or takes longer than 0.25 s.

        While a write hangs, further ones are refused at once.
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
        """Let the thread end once it is through."""
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
            pass  # the reader meets the same end and reports it
        except Exception as error:  # noqa: BLE001 the reader reports it, and ends this attempt
            self.error = error
