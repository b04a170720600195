"""Links of a board to its host: a pseudo terminal that behaves as USB CDC, or memory for tests."""

from __future__ import annotations

import contextlib
import os
import secrets
import select
import termios
import time
import tty
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

TX_FIFO = 256
RX_FIFO = 1024
TERMINAL_BYTES = 4096
"""Buffer size of a Linux pseudo terminal."""


class HostLink(Protocol):
    """A byte stream to a host."""

    counts: Counter[str]

    def read(self) -> bytes:
        """Return the bytes that the host has sent since the last call."""
        ...

    def write(self, data: bytes) -> int:
        """Write bytes; return how many were accepted. Without a host all are accepted and discarded."""
        ...

    def await_bytes(self, count: int) -> None:
        """Wait for the next `count` bytes of the host."""
        ...

    @property
    def is_host_open(self) -> bool:
        """True if a host has the port open."""
        ...

    @property
    def is_plugged(self) -> bool:
        """True if the port exists."""
        ...

    def fileno(self) -> int:
        """Return the file descriptor to poll for input, or -1."""
        ...

    def close(self) -> None:
        """Release all resources."""
        ...


class LineNoise:
    """Random damage to bytes on their way to the host.

    Parameters
    ----------
    corrupt : probability that a byte is replaced by another value.
    lose : probability that a byte is removed.
    seed : seed of the generator.
    """

    def __init__(self, corrupt: float = 0.0, lose: float = 0.0, seed: int = 0) -> None:
        if not (0 <= corrupt <= 1 and 0 <= lose <= 1):
            raise ValueError(f"corrupt {corrupt}, lose {lose}: must be probabilities")
        self.corrupt, self.lose = corrupt, lose
        self.counts: Counter[str] = Counter()
        self._rng = np.random.default_rng(seed)

    def apply(self, data: bytes) -> bytes:
        """Return the bytes as they arrive."""
        if not (self.corrupt or self.lose) or not data:
            return data
        values = np.frombuffer(data, dtype=np.uint8)
        is_corrupted = self._rng.random(len(values)) < self.corrupt
        corrupted = np.where(
            is_corrupted, values ^ self._rng.integers(1, 256, len(values), dtype=np.uint8), values
        )
        survives = self._rng.random(len(values)) >= self.lose
        self.counts["corrupted"] += int(is_corrupted.sum())
        self.counts["lost"] += int((~survives).sum())
        return corrupted[survives].tobytes()


class PtyLink:
    """USB CDC on a pseudo terminal: it vanishes when unplugged and returns under another name.

    link_path: symbolic link that follows the current terminal; removed while there is none.
    """

    def __init__(self, link_path: Path | None = None) -> None:
        self.counts: Counter[str] = Counter()
        self.link_path = link_path
        self._master = -1
        self.name = ""
        self._open = False
        self._last_check = 0.0
        self.plug()

    def plug(self) -> None:
        """Create a new terminal."""
        if self._master >= 0:
            return
        self._master, slave = os.openpty()
        tty.setraw(slave, termios.TCSANOW)
        self.name = os.ttyname(slave)
        os.close(slave)
        os.set_blocking(self._master, False)
        self._open, self._last_check = False, 0.0
        self._buffered, self._awaited_bytes = b"", 0
        self._poll = select.poll()
        self._poll.register(self._master, 0)
        if self.link_path is not None:
            # Creating a symlink never follows an existing one: a random name is safe here.
            new_link = self.link_path.with_name(f".{secrets.token_hex(8)}.new")
            new_link.symlink_to(self.name)
            new_link.replace(self.link_path)

    def unplug(self) -> None:
        """Remove the terminal; a host that has it open gets a hang-up."""
        if self._master < 0:
            return
        if self.link_path is not None:
            with contextlib.suppress(FileNotFoundError):
                self.link_path.unlink()
        os.close(self._master)
        self._master = -1
        self._open = False

    close = unplug

    def fileno(self) -> int:
        """Return the master side while a host is connected; without a host it would always be ready."""
        return self._master if self._open else -1

    @property
    def is_plugged(self) -> bool:
        """True if the terminal exists."""
        return self._master >= 0

    @property
    def is_host_open(self) -> bool:
        """True if a process has the terminal open; checked at most every 5 ms while none has."""
        if self._master < 0:
            return False
        now = time.monotonic()
        if self._open or now - self._last_check > 0.005:
            self._last_check = now
            self._open = not any(event & select.POLLHUP for _, event in self._poll.poll(0))
        return self._open

    def await_bytes(self, count: int) -> None:
        """Wait for the next `count` bytes of the host and buffer them for `read`."""
        self._last_check = 0.0
        self._awaited_bytes += count
        while self._awaited_bytes > 0 and self._master >= 0:
            select.select([self._master], [], [])
            self._buffered += self._read_available()

    def read(self) -> bytes:
        """Return the bytes that the host has written."""
        buffered, self._buffered = self._buffered, b""
        return buffered + self._read_available()

    def _read_available(self) -> bytes:
        """Read the available bytes from the terminal."""
        if self._master < 0:
            return b""
        try:
            data = os.read(self._master, RX_FIFO)
            # The sender may have opened the terminal since the last check, and expects a reply.
            self._last_check = 0.0
            self._awaited_bytes -= len(data)
            return data
        except BlockingIOError:
            return b""
        except OSError:
            self._open = False
            return b""

    def write(self, data: bytes) -> int:
        """Write as much as the terminal accepts; discard everything if no host has it open."""
        if not self.is_host_open:
            self.counts["discarded"] += len(data)
            return len(data)
        try:
            n = os.write(self._master, data)
        except BlockingIOError:
            return 0
        except OSError:
            self.counts["discarded"] += len(data)
            return len(data)
        self.counts["written"] += n
        return n


class MemoryLink:
    """A scripted host in memory that is always connected.

    script: (s, bytes) that it sends at these times. read_pauses: (from s, to s) in which it does not read;
    its terminal then accepts `TERMINAL_BYTES`.
    """

    def __init__(
        self, script: Sequence[tuple[float, bytes]] = (), read_pauses: Sequence[tuple[float, float]] = ()
    ) -> None:
        self.counts: Counter[str] = Counter()
        self.output = bytearray()
        self.arrivals: list[tuple[float, int]] = []
        """(s, total bytes) after each write."""
        self.t = 0.0
        self._script = sorted(script)
        self._read_pauses = tuple(read_pauses)
        self._unread = 0
        self.is_host_open = self.is_plugged = True

    @property
    def next_script_time(self) -> float:
        """Time of the next bytes of the script, s."""
        return self._script[0][0] if self._script else float("inf")

    def read(self) -> bytes:
        """Return the bytes of the script up to the time `t`, s, which the board sets."""
        data = b""
        while self._script and self._script[0][0] <= self.t:
            data += self._script.pop(0)[1]
        return data

    def write(self, data: bytes) -> int:
        """Accept all bytes, or during a read pause as many as fit into the terminal."""
        if any(start <= self.t < end for start, end in self._read_pauses):
            data = data[: TERMINAL_BYTES - self._unread]
            self._unread += len(data)
        else:
            self._unread = 0
        self.output += data
        self.arrivals.append((self.t, len(self.output)))
        self.counts["written"] += len(data)
        return len(data)

    def await_bytes(self, count: int) -> None:
        """Do nothing: the script has its own times."""

    def fileno(self) -> int:
        """Return -1: there is nothing to poll."""
        return -1

    def close(self) -> None:
        """Do nothing."""
