"""A fake turntable on a pseudo terminal: answers lines as the real one does, refusals included.

Nobody has a table of this protocol here; the refusals are those that the protocol names: `ERR` and words.
"""

from __future__ import annotations

import contextlib
import os
import threading
import tty
from collections.abc import Callable


class FakeTable:
    """Runs inside `with`. off: degrees by which it misses. silent: never answers. jammed: does not turn.

    good: moves before it is off or jammed. turning: lasts as long as a move. visited: degrees at which it
    stopped, in order.
    """

    def __init__(
        self,
        *,
        off: float = 0.0,
        silent: bool = False,
        jammed: bool = False,
        good: int = 0,
        turning: Callable[[], None] = lambda: None,
    ) -> None:
        self._far, self._near = os.openpty()
        tty.setraw(self._far)
        tty.setraw(self._near)
        self.path = os.ttyname(self._near)
        self.at = 0.0
        self.visited: list[float] = []
        self._off, self._silent, self._jammed, self._good = off, silent, jammed, good
        self._turning = turning
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def __enter__(self) -> FakeTable:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._near)
        with contextlib.suppress(OSError):
            os.close(self._far)

    def _serve(self) -> None:
        buffer = b""
        with contextlib.suppress(OSError):  # closed meanwhile
            while data := os.read(self._far, 256):
                *lines, buffer = (buffer + data).split(b"\n")
                for line in lines:
                    answer = self._answer(line.decode("ascii", "replace").strip())
                    if not self._silent:
                        os.write(self._far, answer.encode() + b"\n")

    def _answer(self, line: str) -> str:
        word, _, rest = line.partition(" ")
        if word == "ANGLE?" and not rest:
            return f"ANGLE {self.at:.4f}"
        if word != "GOTO":
            return "ERR unknown command"
        try:
            wanted = float(rest)
        except ValueError:
            return "ERR no angle"
        faulty = len(self.visited) >= self._good
        if self._jammed and faulty:
            return "ERR jammed"
        self._turning()
        self.at = wanted + (self._off if faulty else 0.0)
        self.visited.append(self.at)
        return f"OK {self.at:.4f}"
