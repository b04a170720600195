"""Verbs that are run on a recording at a visitor's wish: in processes of their own, one after the other.

A process of its own, at a low priority, keeps them from slowing a recording.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import os
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

_MOST = 40
_MOST_WAITING = 8
_NICE = 10
_READ = 4096
_BAR = re.compile(r"([^\r\n]*?)\s*[━╸╺ ]*\s(\d+)%")
_ESCAPE = re.compile(r"\x1b(\[[0-9;?]*[A-Za-z]|.)")


@dataclass
class Job:
    """state: waiting, running, done, failed. progress: 0 to 1. result: what the verb printed as JSON."""

    number: int
    kind: str
    name: str
    words: Sequence[str]
    state: str = "waiting"
    progress: float = 0.0
    text: str = ""
    result: Any = None
    makes: Path | None = None
    """A file that a run without a failure leaves; its folder is made before."""
    keep: Path | None = None
    """Where the JSON is kept."""
    _lines: str = field(default="", repr=False)

    def as_json(self) -> dict[str, Any]:
        return {
            "id": self.number,
            "kind": self.kind,
            "name": self.name,
            "state": self.state,
            "progress": self.progress,
            "text": self.text,
            "result": self.result,
        }

    def heard(self, said: str) -> None:
        """What the verb wrote for people: the newest progress, or its error."""
        self._lines = (self._lines + _ESCAPE.sub("", said))[-_READ:]
        bars = _BAR.findall(self._lines)
        if bars:
            self.text, self.progress = bars[-1][0].strip(), int(bars[-1][1]) / 100.0

    def end(self, code: int, printed: bytes) -> None:
        """The verb has ended."""
        try:
            self.result = json.loads(printed) if printed.strip() else None
        except ValueError:
            code = code or 1
        if code and self.result is None:
            lines = [line.strip() for line in self._lines.replace("\r", "\n").split("\n") if line.strip()]
            self.state, self.text = "failed", lines[-1] if lines else f"ended with code {code}"
            return
        if self.keep is not None:
            self.keep.write_bytes(printed)
        self.state, self.progress, self.text = "done", 1.0, ""


class Jobs:
    """The newest jobs; used on the server's loop alone."""

    def __init__(self) -> None:
        self._numbers = itertools.count(1)
        self._jobs: dict[int, Job] = {}
        self._one = asyncio.Lock()
        self._tasks: set[asyncio.Task[None]] = set()

    def get(self, number: int) -> Job | None:
        """None for one that is not known any more."""
        return self._jobs.get(number)

    def start(
        self,
        kind: str,
        name: str,
        words: Sequence[str],
        *,
        makes: Path | None = None,
        keep: Path | None = None,
    ) -> Job | None:
        """Runs `hubodo WORDS --json` once those before it are through; None where too many wait.

        The same once more while it still runs is that one.
        """
        going = [job for job in self._jobs.values() if job.state in ("waiting", "running")]
        for job in going:
            if (job.kind, job.name, job.words) == (kind, name, words):
                return job
        if len(going) >= _MOST_WAITING:
            return None
        job = Job(next(self._numbers), kind, name, words, makes=makes, keep=keep)
        self._jobs[job.number] = job
        while len(self._jobs) > _MOST:
            self._jobs.pop(next(iter(self._jobs)))
        task = asyncio.get_running_loop().create_task(self._run(job))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return job

    async def close(self) -> None:
        """Ends what still runs."""
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _run(self, job: Job) -> None:
        async with self._one:
            job.state = "running"
            try:
                for file in (job.makes, job.keep):
                    if file is not None:
                        file.parent.mkdir(parents=True, exist_ok=True)
                await self._verb(job)
            except OSError as error:
                job.state, job.text = "failed", f"{error.filename or job.name}: {error.strerror}"

    async def _verb(self, job: Job) -> None:
        watched, theirs = _terminal()
        command = [sys.executable, "-m", "hubodo.cli", *job.words, "--json"]
        environment = {**os.environ, "TERM": "xterm", "COLUMNS": "120", "OPENBLAS_NUM_THREADS": "1"}
        try:
            process = await asyncio.create_subprocess_exec(
                *command,
                stdin=asyncio.subprocess.DEVNULL,
                stdout=asyncio.subprocess.PIPE,
                stderr=theirs,
                env=environment,
                start_new_session=True,
            )
        finally:
            os.close(theirs)
        with contextlib.suppress(OSError, AttributeError):
            os.setpriority(os.PRIO_PROCESS, process.pid, _NICE)
        listening = asyncio.get_running_loop()
        listening.add_reader(watched, _listen, watched, job)
        try:
            printed, _ = await process.communicate()
            _listen(watched, job)
            job.end(process.returncode or 0, printed)
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
            listening.remove_reader(watched)
            os.close(watched)


def _terminal() -> tuple[int, int]:
    """A pseudo terminal: verbs show their progress where a person watches."""
    import pty

    watched, theirs = pty.openpty()
    os.set_blocking(watched, False)
    return watched, theirs


def _listen(watched: int, job: Job) -> None:
    try:
        while said := os.read(watched, _READ):
            job.heard(said.decode("utf-8", "replace"))
    except BlockingIOError:
        return
    except OSError:  # nobody writes there any more
        asyncio.get_running_loop().remove_reader(watched)
