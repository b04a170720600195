"""The localizer in a process of its own: a step of its graph takes longer than odometry may be late.

Run as a module it is that process: pickled items on stdin, pickled answers on stdout, until stdin ends.
"""

from __future__ import annotations

import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import BinaryIO

from hubodo.errors import ConfigError
from hubodo.fuse.wheel.step import Pose
from hubodo.ingest.live.localizer import FixSample, Localizer, Located

_PATIENCE_S = 20.0
_NICER = 5


@dataclass(frozen=True, slots=True)
class Answer:
    """What an item led to; arrived_ns: of the item. ended: nothing more comes, for what `warnings` say."""

    located: Located | None
    warnings: tuple[str, ...]
    arrived_ns: int
    ended: bool = False


class LocalizerProcess:
    """Give it poses and fixes in their order; `answer` is called with what becomes of them, from a thread of
    its own."""

    def __init__(self, t_zero_ns: int, answer: Callable[[Answer], None]) -> None:
        """t_zero_ns: host time of t = 0 of the poses."""
        environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(path for path in sys.path if path),
            "OPENBLAS_NUM_THREADS": "1",
        }
        self._child = subprocess.Popen(
            [sys.executable, "-m", "hubodo.ingest.live.localizer_process", str(t_zero_ns)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment,
        )
        self._items: queue.SimpleQueue[tuple[Pose | FixSample, int] | None] = queue.SimpleQueue()
        self._answer = answer
        self._threads = [
            threading.Thread(target=work, daemon=True, name=f"localizer {work.__name__}")
            for work in (self._write, self._read)
        ]
        for thread in self._threads:
            thread.start()

    def put(self, item: Pose | FixSample, arrived_ns: int) -> None:
        """The next pose or fix, and when it was known."""
        self._items.put((item, arrived_ns))

    def close(self) -> bool:
        """Waits for the answers to all that was put; False when they did not come in time."""
        self._items.put(None)
        for thread in self._threads:
            thread.join(_PATIENCE_S)
        done = not any(thread.is_alive() for thread in self._threads)
        if not done:
            self.stop()
        return done

    def stop(self) -> None:
        """Ends it at once, if it still runs."""
        self._child.kill()
        self._child.wait()

    def _write(self) -> None:
        assert self._child.stdin is not None
        try:
            with self._child.stdin as pipe:
                while (item := self._items.get()) is not None:
                    pickle.dump(item, pipe)
                    if self._items.empty():
                        pipe.flush()
        except OSError:
            pass  # the reader of its answers says why it is gone

    def _read(self) -> None:
        assert self._child.stdout is not None
        ended = False
        with self._child.stdout as pipe:
            while True:
                try:
                    answer: Answer = pickle.load(pipe)
                except (EOFError, OSError, pickle.UnpicklingError):
                    break
                ended = ended or answer.ended
                self._answer(answer)
        code = self._child.wait()
        if code and not ended:
            text = f"the process of the map died with status {code}; map → odom ends here, all else goes on"
            self._answer(Answer(None, (text,), 0, ended=True))


def main(arguments: list[str], source: BinaryIO, target: BinaryIO) -> int:
    """The process: arguments are t_zero_ns."""
    # Ctrl-C is for the recorder, which then lets this one come to its end.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "nice"):
        os.nice(_NICER)
    try:
        localizer = Localizer(int(arguments[0]))
    except ConfigError as error:
        _send(target, Answer(None, (f"map → odom is not published: {error}",), 0, ended=True))
        return 0
    while True:
        try:
            item, arrived_ns = pickle.load(source)
        except EOFError:
            return 0
        located = None
        if isinstance(item, FixSample):
            localizer.fix(item)
        else:
            located = localizer.odometry(item)
        warnings = tuple(localizer.warnings())
        if located is not None or warnings:
            _send(target, Answer(located, warnings, arrived_ns))


def _send(target: BinaryIO, answer: Answer) -> None:
    pickle.dump(answer, target)
    target.flush()


if __name__ == "__main__":
    # The classes of the module by its name, not those of __main__, are what the recorder can read.
    from hubodo.ingest.live.localizer_process import main as run

    sys.exit(run(sys.argv[1:], sys.stdin.buffer, sys.stdout.buffer))
