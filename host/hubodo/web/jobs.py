"""Jobs: verbs that a visitor runs on a recording, one after the other, each in its own process.

The process has a low priority, so that it does not slow down a recording, and a time limit. Its files go into
a scratch folder first, and to their destination once the verb has succeeded.
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

_MAX_REMEMBERED_JOBS = 40
_MAX_WAITING_JOBS = 8
_NICENESS = 10
_READ_BYTES = 4096
_GRACE_S = 1.0
"""Time between SIGTERM and SIGKILL of a cancelled verb, s."""
_UNFINISHED_STATES = ("waiting", "running")
SCRATCH = "{scratch}"
_PROGRESS_BAR = re.compile(r"([^\r\n]*?)\s*[━╸╺ ]*\s(\d+)%")
_TERMINAL_ESCAPE = re.compile(r"\x1b(\[[0-9;?]*[A-Za-z]|.)")

PublishFiles = Callable[[Path], None]


@dataclass
class Job:
    """A verb that runs on a recording.

    Attributes
    ----------
    number
        Id of the job.
    kind
        info, report or gap.
    name
        Name of the recording.
    words
        Command line of the verb.
    state
        waiting, running, done, failed or cancelled.
    progress
        Completed share, 0 to 1.
    text
        Present step, or the error.
    result
        JSON result of the verb.
    publish
        Moves the files of the scratch folder to their destination.
    limit
        Time limit, s.
    task
        The asyncio task that runs the job.
    """

    number: int
    kind: str
    name: str
    words: Sequence[str]
    state: str = "waiting"
    progress: float = 0.0
    text: str = ""
    result: Any = None
    publish: PublishFiles | None = None
    limit: float = 3600.0
    task: asyncio.Task[None] | None = field(default=None, repr=False)
    _lines: str = field(default="", repr=False)

    def as_json(self) -> dict[str, Any]:
        """Return the JSON form for the page."""
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

    def read_output(self, output: str) -> None:
        """Update progress and text from the terminal output of the verb."""
        self._lines = (self._lines + _TERMINAL_ESCAPE.sub("", output))[-_READ_BYTES:]
        bars = _PROGRESS_BAR.findall(self._lines)
        if bars:
            self.text, self.progress = bars[-1][0].strip(), int(bars[-1][1]) / 100.0

    def finish(self, exit_code: int, output: bytes) -> None:
        """Set result and final state from exit code and standard output."""
        try:
            self.result = json.loads(output) if output.strip() else None
        except ValueError:
            exit_code = exit_code or 1
        if exit_code and self.result is None:
            lines = [line.strip() for line in self._lines.replace("\r", "\n").split("\n") if line.strip()]
            self.state, self.text = "failed", lines[-1] if lines else f"exit code {exit_code}"
            return
        self.state, self.progress, self.text = "done", 1.0, ""


class JobQueue:
    """The queue of jobs and the newest results; used only on the server's event loop."""

    def __init__(self, limit: float) -> None:
        """Create an empty queue; `limit` is the time limit of a job, s."""
        self._limit = limit
        self._numbers = itertools.count(1)
        self._jobs: dict[int, Job] = {}
        self._running_lock = asyncio.Lock()
        self._tasks: set[asyncio.Task[None]] = set()

    def get(self, number: int) -> Job | None:
        """Return a job by its number, or None if it is no longer known."""
        return self._jobs.get(number)

    def start(self, kind: str, name: str, words: Sequence[str], publish: PublishFiles | None) -> Job | None:
        """Queue `hubodo WORDS --json`; return None if too many jobs are waiting.

        SCRATCH at the start of a word stands for the scratch folder. An unfinished job with the same words is
        returned instead of a new one.
        """
        unfinished = [job for job in self._jobs.values() if job.state in _UNFINISHED_STATES]
        for job in unfinished:
            if (job.kind, job.name, job.words) == (kind, name, words):
                return job
        if len(unfinished) >= _MAX_WAITING_JOBS:
            return None
        job = Job(next(self._numbers), kind, name, words, publish=publish, limit=self._limit)
        self._jobs[job.number] = job
        while len(self._jobs) > _MAX_REMEMBERED_JOBS:
            self._jobs.pop(next(iter(self._jobs)))
        task = asyncio.get_running_loop().create_task(self._run(job))
        job.task = task
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return job

    def cancel(self, job: Job) -> None:
        """Cancel a waiting or running job, with all processes that it started."""
        if job.state in _UNFINISHED_STATES and job.task is not None:
            job.state, job.text = "cancelled", "cancelled"
            job.task.cancel()

    async def close(self) -> None:
        """Cancel all unfinished jobs."""
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _run(self, job: Job) -> None:
        async with self._running_lock:
            job.state = "running"
            try:
                with tempfile.TemporaryDirectory(prefix="hubodo-") as scratch:
                    async with asyncio.timeout(self._limit):
                        await self._run_verb(job, scratch)
                    if job.state == "done" and job.publish is not None:
                        job.publish(Path(scratch))
            except TimeoutError:
                job.state = "failed"
                job.text = f"stopped after {_minutes(self._limit)}, the time limit ([web] job_limit)"
            except OSError as error:
                job.state, job.text = "failed", f"{error.filename or job.name}: {error.strerror}"

    async def _run_verb(self, job: Job, scratch: str) -> None:
        terminal, child_end = _open_terminal()
        words = [scratch + word[len(SCRATCH) :] if word.startswith(SCRATCH) else word for word in job.words]
        command = [sys.executable, "-m", "hubodo.cli", *words, "--json"]
        environment = {**os.environ, "TERM": "xterm", "COLUMNS": "120", "OPENBLAS_NUM_THREADS": "1"}
        try:
            process = await asyncio.create_subprocess_exec(
                *command,
                stdin=asyncio.subprocess.DEVNULL,
                stdout=asyncio.subprocess.PIPE,
                stderr=child_end,
                env=environment,
                start_new_session=True,
            )
        finally:
            os.close(child_end)
        with contextlib.suppress(OSError, AttributeError):
            os.setpriority(os.PRIO_PROCESS, process.pid, _NICENESS)
        is_finished, loop = False, asyncio.get_running_loop()
        loop.add_reader(terminal, _read_terminal, terminal, job)
        try:
            printed, _ = await process.communicate()
            _read_terminal(terminal, job)
            job.finish(process.returncode or 0, printed)
            is_finished = True
        finally:
            if not is_finished:
                await _end_group(process)
            loop.remove_reader(terminal)
            os.close(terminal)


async def _end_group(process: asyncio.subprocess.Process) -> None:
    """Terminate a verb and its process group."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, number)
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(process.wait(), _GRACE_S)


def _minutes(seconds: float) -> str:
    return f"{seconds / 60.0:.0f} min" if seconds >= 120.0 else f"{seconds:.0f} s"


def _open_terminal() -> tuple[int, int]:
    """Open a pseudo terminal, so that verbs print their progress."""
    import pty

    terminal, child_end = pty.openpty()
    os.set_blocking(terminal, False)
    return terminal, child_end


def _read_terminal(terminal: int, job: Job) -> None:
    try:
        while output := os.read(terminal, _READ_BYTES):
            job.read_output(output.decode("utf-8", "replace"))
    except BlockingIOError:
        return
    except OSError:  # the verb has closed the terminal
        asyncio.get_running_loop().remove_reader(terminal)
