"""Verbs that a visitor has run on a recording: one after the other, each in a process of its own.

The process has a low priority, so that it does not slow a recording, and a time limit. What it writes goes
into a scratch folder, and from there to its place once the verb has succeeded.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import os
import re
import signal
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

_MOST = 40
_MOST_WAITING = 8
_NICE = 10
_READ = 4096
_GRACE_S = 1.0
"""s from the wish that a verb ends to its being killed."""
_UNFINISHED = ("waiting", "running")
SCRATCH = "{scratch}"
_BAR = re.compile(r"([^\r\n]*?)\s*[━╸╺ ]*\s(\d+)%")
_ESCAPE = re.compile(r"\x1b(\[[0-9;?]*[A-Za-z]|.)")

Publish = Callable[[Path], None]


@dataclass
class Job:
    """state: waiting, running, done, failed, cancelled. progress: 0 to 1. result: the JSON of the verb.

    publish: takes the files of the scratch folder over. limit: s that it may run.
    """

    number: int
    kind: str
    name: str
    words: Sequence[str]
    state: str = "waiting"
    progress: float = 0.0
    text: str = ""
    result: Any = None
    publish: Publish | None = None
    limit: float = 3600.0
    task: asyncio.Task[None] | None = field(default=None, repr=False)
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
            "limit": self.limit,
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
        self.state, self.progress, self.text = "done", 1.0, ""


class Jobs:
    """The newest jobs; used on the server's loop alone."""

    def __init__(self, limit: float) -> None:
        """limit: s that a job may run."""
        self._limit = limit
        self._numbers = itertools.count(1)
        self._jobs: dict[int, Job] = {}
        self._one = asyncio.Lock()
        self._tasks: set[asyncio.Task[None]] = set()

    def get(self, number: int) -> Job | None:
        """None for one that is not known any more."""
        return self._jobs.get(number)

    def start(self, kind: str, name: str, words: Sequence[str], publish: Publish | None) -> Job | None:
        """Run `hubodo WORDS --json` once those before it have ended; None where too many wait.

        SCRATCH at the start of a word stands for the scratch folder. The same words while they still run are
        that job.
        """
        going = [job for job in self._jobs.values() if job.state in _UNFINISHED]
        for job in going:
            if (job.kind, job.name, job.words) == (kind, name, words):
                return job
        if len(going) >= _MOST_WAITING:
            return None
        job = Job(next(self._numbers), kind, name, words, publish=publish, limit=self._limit)
        self._jobs[job.number] = job
        while len(self._jobs) > _MOST:
            self._jobs.pop(next(iter(self._jobs)))
        task = asyncio.get_running_loop().create_task(self._run(job))
        job.task = task
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return job

    def cancel(self, job: Job) -> None:
        """End a job that waits or runs, with all processes that it started."""
        if job.state in _UNFINISHED and job.task is not None:
            job.state, job.text = "cancelled", "cancelled"
            job.task.cancel()

    async def close(self) -> None:
        """Ends what still runs."""
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _run(self, job: Job) -> None:
        async with self._one:
            job.state = "running"
            try:
                with tempfile.TemporaryDirectory(prefix="hubodo-") as scratch:
                    async with asyncio.timeout(self._limit):
                        await self._verb(job, scratch)
                    if job.state == "done" and job.publish is not None:
                        job.publish(Path(scratch))
            except TimeoutError:
                job.state = "failed"
                job.text = f"stopped after {_minutes(self._limit)}, the time limit ([web] job_limit)"
            except OSError as error:
                job.state, job.text = "failed", f"{error.filename or job.name}: {error.strerror}"

    async def _verb(self, job: Job, scratch: str) -> None:
        watched, theirs = _terminal()
        words = [scratch + word[len(SCRATCH) :] if word.startswith(SCRATCH) else word for word in job.words]
        command = [sys.executable, "-m", "hubodo.cli", *words, "--json"]
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
        ended, listening = False, asyncio.get_running_loop()
        listening.add_reader(watched, _listen, watched, job)
        try:
            printed, _ = await process.communicate()
            _listen(watched, job)
            job.end(process.returncode or 0, printed)
            ended = True
        finally:
            if not ended:
                await _end_group(process)
            listening.remove_reader(watched)
            os.close(watched)


async def _end_group(process: asyncio.subprocess.Process) -> None:
    """End a verb and all that it started: it leads a process group of its own."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, number)
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(process.wait(), _GRACE_S)


def _minutes(seconds: float) -> str:
    return f"{seconds / 60.0:.0f} min" if seconds >= 120.0 else f"{seconds:.0f} s"


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
