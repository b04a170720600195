"""What the board is plugged into: a pseudo terminal that behaves as USB CDC, or memory for tests."""

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
"""What a pseudo terminal of Linux holds for a host that does not read."""


class HostLink(Protocol):
    """One byte stream to a host."""

    counts: Counter[str]

    def read(self) -> bytes:
        """What the host has sent since, possibly nothing."""
        ...

    def write(self, data: bytes) -> int:
        """How many bytes went out at once; with no host all of them, into nowhere."""
        ...

    def await_bytes(self, count: int) -> None:
        """Waits until the host's next bytes, so many, have come."""
        ...

    @property
    def host_open(self) -> bool:
        """Whether a host holds the port open."""
        ...

    @property
    def plugged(self) -> bool:
        """Whether there is a port."""
        ...

    def fileno(self) -> int:
        """Descriptor to wait on for input, -1 for none."""
        ...

    def close(self) -> None:
        """Give everything back."""
        ...


class LineNoise:
    """A relay that spoils bytes on their way to the host.

    Args:
        corrupt: probability that a byte is replaced by another value.
        lose: probability that a byte is cut out.
        seed: of the generator.
    """

    def __init__(self, corrupt: float = 0.0, lose: float = 0.0, seed: int = 0) -> None:
        if not (0 <= corrupt <= 1 and 0 <= lose <= 1):
            raise ValueError(f"corrupt {corrupt}, lose {lose}: want probabilities")
        self.corrupt, self.lose = corrupt, lose
        self.counts: Counter[str] = Counter()
        self._rng = np.random.default_rng(seed)

    def apply(self, data: bytes) -> bytes:
        """The bytes as they arrive."""
        if not (self.corrupt or self.lose) or not data:
            return data
        values = np.frombuffer(data, dtype=np.uint8)
        hit = self._rng.random(len(values)) < self.corrupt
        changed = np.where(hit, values ^ self._rng.integers(1, 256, len(values), dtype=np.uint8), values)
        kept = self._rng.random(len(values)) >= self.lose
        self.counts["corrupted"] += int(hit.sum())
        self.counts["lost"] += int((~kept).sum())
        return changed[kept].tobytes()


class PtyLink:
    """USB CDC as the host sees it: a terminal that goes when unplugged and comes back under another name.

    Args:
        link_path: symbolic link kept on the terminal in being, removed while there is none.
    """

    def __init__(self, link_path: Path | None = None) -> None:
        self.counts: Counter[str] = Counter()
        self.link_path = link_path
        self._master = -1
        self.name = ""
        self._open = False
        self._looked = 0.0
        self.plug()

    def plug(self) -> None:
        """A new terminal appears."""
        if self._master >= 0:
            return
        self._master, slave = os.openpty()
        tty.setraw(slave, termios.TCSANOW)
        self.name = os.ttyname(slave)
        os.close(slave)
        os.set_blocking(self._master, False)
        self._open, self._looked = False, 0.0
        self._kept, self._owed = b"", 0
        self._poll = select.poll()
        self._poll.register(self._master, 0)
        if self.link_path is not None:
            # A symlink is made or refused, never followed: a random name is all that it takes.
            fresh = self.link_path.with_name(f".{secrets.token_hex(8)}.new")
            fresh.symlink_to(self.name)
            fresh.replace(self.link_path)

    def unplug(self) -> None:
        """The terminal is gone; a host that holds it meets a hang-up."""
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
        """The master side while a host is there: without one it would be ready for ever."""
        return self._master if self._open else -1

    @property
    def plugged(self) -> bool:
        """Whether the terminal is there."""
        return self._master >= 0

    @property
    def host_open(self) -> bool:
        """Whether some process has the terminal open; looked up at most every 5 ms while nobody has."""
        if self._master < 0:
            return False
        now = time.monotonic()
        if self._open or now - self._looked > 0.005:
            self._looked = now
            self._open = not any(event & select.POLLHUP for _, event in self._poll.poll(0))
        return self._open

    def await_bytes(self, count: int) -> None:
        """See `HostLink`; they are kept for `read`."""
        self._looked = 0.0
        self._owed += count
        while self._owed > 0 and self._master >= 0:
            select.select([self._master], [], [])
            self._kept += self._take()

    def read(self) -> bytes:
        """Bytes the host has written."""
        kept, self._kept = self._kept, b""
        return kept + self._take()

    def _take(self) -> bytes:
        if self._master < 0:
            return b""
        try:
            data = os.read(self._master, RX_FIFO)
            # Whoever wrote that may have come since the last look, and wants the answer.
            self._looked = 0.0
            self._owed -= len(data)
            return data
        except BlockingIOError:
            return b""
        except OSError:
            self._open = False
            return b""

    def write(self, data: bytes) -> int:
        """As much as the terminal takes; everything, discarded, when nobody has it open."""
        if not self.host_open:
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
    """A host that is always there; what it says is a script of (s, bytes).

    It takes everything, but for the stretches (from s, to s) of `deaf`, in which it does not read: its
    terminal then takes what one holds.
    """

    def __init__(
        self, script: Sequence[tuple[float, bytes]] = (), deaf: Sequence[tuple[float, float]] = ()
    ) -> None:
        self.counts: Counter[str] = Counter()
        self.output = bytearray()
        self.arrivals: list[tuple[float, int]] = []
        """(s, bytes that had come by then), for each write."""
        self.t = 0.0
        self._script = sorted(script)
        self._deaf = tuple(deaf)
        self._unread = 0
        self.host_open = self.plugged = True

    @property
    def next_word(self) -> float:
        """s at which the script says its next."""
        return self._script[0][0] if self._script else float("inf")

    def read(self) -> bytes:
        """What the script has sent by the time `t`, s, that the board has set."""
        data = b""
        while self._script and self._script[0][0] <= self.t:
            data += self._script.pop(0)[1]
        return data

    def write(self, data: bytes) -> int:
        """Takes all, or what still fits in the terminal of a host that does not read."""
        if any(begin <= self.t < end for begin, end in self._deaf):
            data = data[: TERMINAL_BYTES - self._unread]
            self._unread += len(data)
        else:
            self._unread = 0
        self.output += data
        self.arrivals.append((self.t, len(self.output)))
        self.counts["written"] += len(data)
        return len(data)

    def await_bytes(self, count: int) -> None:
        """Its script comes by itself."""

    def fileno(self) -> int:
        """Nothing to wait on."""
        return -1

    def close(self) -> None:
        """Nothing to give back."""
