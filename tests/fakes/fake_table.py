"""A fake turntable on a pseudo terminal with the protocol of `sensors/north/table.py`, including refusals.

It turns in a thread of its own, so that it answers while it moves, as a real table does.
"""

from __future__ import annotations

import contextlib
import os
import threading
import tty
from collections.abc import Callable

DIGITS = 4


class FakeTable:
    """A turntable that runs inside `with`.

    off: error of each move, degrees. silent: True if it never answers. jammed: True if it does not turn.
    stuck: True if it stays busy for ever. limits: range of angles, degrees. garbled: n, to send noise in
    place of every n-th answer. version: version that it reports. good: number of moves before off, jammed or
    stuck take effect. turning: called for each move with the angles from and to, degrees, and a function that
    sets the angle. visited: angles at which it stopped, degrees, in order.
    """

    def __init__(
        self,
        *,
        off: float = 0.0,
        silent: bool = False,
        jammed: bool = False,
        stuck: bool = False,
        limits: tuple[float, float] | None = None,
        garbled: int = 0,
        version: int = 1,
        good: int = 0,
        turning: Callable[..., None] = lambda *_: None,
    ) -> None:
        self._far, self._near = os.openpty()
        tty.setraw(self._far)
        tty.setraw(self._near)
        self.path = os.ttyname(self._near)
        self.at = 0.0
        self.visited: list[float] = []
        self.stopped = 0
        self._off, self._silent, self._jammed, self._stuck = off, silent, jammed, stuck
        self._limits, self._garbled, self._version, self._good = limits, garbled, version, good
        self._turning, self._busy, self._answers = turning, False, 0
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def __enter__(self) -> FakeTable:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._near)
        # If closed while the thread reads, the descriptor could be reused by another table.
        self._thread.join(2.0)
        with contextlib.suppress(OSError):
            os.close(self._far)

    def _serve(self) -> None:
        buffer = b""
        with contextlib.suppress(OSError):  # closed meanwhile
            while data := os.read(self._far, 256):
                *lines, buffer = (buffer + data).split(b"\n")
                for line in lines:
                    answer = self._answer(line.decode("ascii", "replace").strip())
                    self._answers += 1
                    if self._garbled and self._answers % self._garbled == 0:
                        answer = "\x7f#"
                    if not self._silent:
                        os.write(self._far, answer.encode() + b"\n")

    def _answer(self, line: str) -> str:
        word, _, incomplete = line.partition(" ")
        if line == "TABLE?":
            return f"TABLE {self._version} fake"
        if line == "LIMITS?":
            return "LIMITS NONE" if self._limits is None else "LIMITS {:.1f} {:.1f}".format(*self._limits)
        if line == "POS?":
            return f"POS {self.at:.{DIGITS}f} {'BUSY' if self._busy else 'IDLE'}"
        if line == "STOP":
            self.stopped += 1
            self._busy = False
            return "OK"
        if word != "GOTO":
            return "ERR unknown command"
        return self._goto(incomplete)

    def _goto(self, incomplete: str) -> str:
        try:
            wanted = float(incomplete)
        except ValueError:
            return "ERR no angle"
        if self._limits is not None and not self._limits[0] <= wanted <= self._limits[1]:
            return "ERR LIMIT"
        if self._busy:
            return "OK" if wanted == self._wanted else "ERR BUSY"
        faulty = len(self.visited) >= self._good
        if self._jammed and faulty:
            return "ERR jammed"
        self._busy, self._wanted = True, wanted
        if not (self._stuck and faulty):
            threading.Thread(target=self._move, args=(wanted, self._off * faulty), daemon=True).start()
        return "OK"

    def _move(self, wanted: float, off: float) -> None:
        self._turning(self.at, wanted, self._put)
        self.at = wanted + off
        self.visited.append(self.at)
        self._busy = False

    def _put(self, at: float) -> None:
        self.at = at
