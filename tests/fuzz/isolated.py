"""Run one case in a process with limits, so that the next one always runs."""

from __future__ import annotations

import os
import resource
import select
import signal
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from fuzz.case import Case
from fuzz.judge import judge

PROCESSOR_S = 30
"""Processor time after which a case counts as hanging."""
WALL_S = 120
"""Wall time after which a case counts as hanging, on a machine that may be busy."""
PEAK_BYTES = 1 << 30
"""Memory that a case may take beyond that of an idle process, four times what reading a file may."""

Kind = Literal["passed", "defect", "slow", "memory"]


@dataclass(frozen=True)
class Outcome:
    """The outcome of a case. text: exit code or error. seconds: processor time. peak: memory, bytes."""

    kind: Kind
    text: str
    seconds: float
    peak: int


def run_isolated(case: Case) -> Outcome:
    """Run a case in a forked process with limits of processor time and memory."""
    reading, writing = os.pipe()
    idle = _resident_bytes()
    child = os.fork()
    if child == 0:
        os.close(reading)
        _run_child(case, writing)
    os.close(writing)
    text, hangs = _receive(reading, child)
    os.close(reading)
    _, status, usage = os.wait4(child, 0)
    seconds = usage.ru_utime + usage.ru_stime
    peak = max(0, usage.ru_maxrss * 1024 - idle)
    if hangs or (os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGXCPU):
        return Outcome("slow", f"slow: {' '.join(case.words)}: beyond {PROCESSOR_S} s", seconds, peak)
    if peak > PEAK_BYTES or "MemoryError" in text or "not enough memory" in text:
        return Outcome("memory", f"memory: {' '.join(case.words)}: {peak >> 20} MB, {text}", seconds, peak)
    if os.WIFSIGNALED(status):
        name = signal.Signals(os.WTERMSIG(status)).name
        return Outcome("defect", f"signal: {' '.join(case.words)}: ended by {name}", seconds, peak)
    return Outcome("passed" if text.startswith("code ") else "defect", text, seconds, peak)


def _resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def _run_child(case: Case, writing: int) -> None:
    """Run the case and report; never returns."""
    try:
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (PROCESSOR_S, PROCESSOR_S + 1))
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        most = pages * resource.getpagesize() + 2 * PEAK_BYTES
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
        done = judge(case)
        text = f"code {done.code} {done.err}"
    except BaseException as error:  # noqa: BLE001 - what is looked for
        text = f"{type(error).__name__}: {error}"
    try:
        os.write(writing, text.encode("utf-8", "backslashreplace")[:60_000])
    finally:
        os._exit(0)


def _receive(reading: int, child: int) -> tuple[str, bool]:
    """Return what the child reports and whether it had to be stopped."""
    parts, end = [], time.monotonic() + WALL_S
    while True:
        ready, _, _ = select.select([reading], [], [], max(0.0, end - time.monotonic()))
        if not ready:
            os.kill(child, signal.SIGKILL)
            return "", True
        part = os.read(reading, 65536)
        if not part:
            return b"".join(parts).decode(), False
        parts.append(part)
