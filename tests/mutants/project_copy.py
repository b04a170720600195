"""A copy of the project in which tests run, and in which one mutant at a time lives."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from mutants.operators import Mutant

ROOT = Path(__file__).resolve().parents[2]
WALL = 10.0
"""Times its processor time that a run may take; then it hangs."""


@dataclass(frozen=True)
class Run:
    """code: what pytest ended with, negative where it was killed for its time. seconds: of the processor."""

    code: int
    seconds: float


class ProjectCopy:
    """All files that git knows of, as they are in the working tree."""

    def __init__(self, folder: Path) -> None:
        self.root = folder / "hubodo"
        listed = subprocess.run(
            ["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True, text=True
        )
        for name in filter(None, listed.stdout.split("\0")):
            target = self.root / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, target)
        for name in ("node_modules", ".venv"):
            (self.root / name).symlink_to(ROOT / name)
        self._versions = 0
        self._environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(str(self.root / name) for name in ("host", "protocol", "tests")),
            "HUBODO_SHARED": os.environ.get("HUBODO_SHARED", str(ROOT.parent / "shared")),
        }
        self._environment.pop("PYTHONDONTWRITEBYTECODE", None)

    @contextmanager
    def having(self, mutant: Mutant) -> Iterator[None]:
        """With the mutant in its file.

        Each version of the file has a time of its own, so that byte code is never that of another one.
        """
        file = self.root / mutant.path
        sound, as_before = file.read_bytes(), file.stat().st_mtime_ns
        self._versions += 1
        file.write_bytes(sound[: mutant.start] + mutant.new.encode() + sound[mutant.end :])
        os.utime(file, (self._versions, self._versions))
        try:
            yield
        finally:
            file.write_bytes(sound)
            os.utime(file, ns=(as_before, as_before))

    def pytest(self, arguments: Sequence[str], limit: float, **environment: str) -> Run:
        """Tests that do not wait for the clock. limit: seconds of processor time, see `chosen.py`."""
        run = subprocess.Popen(
            [sys.executable, "-m", "pytest", "-m", "not real_time", "-p", "no:cacheprovider", *arguments],
            cwd=self.root,
            env={**self._environment, **environment, "MUTANTS_SECONDS": str(limit)},
            start_new_session=True,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        hangs = threading.Timer(WALL * limit, os.killpg, (run.pid, signal.SIGKILL))
        hangs.start()
        _, status, used = os.wait4(run.pid, 0)
        hangs.cancel()
        run.returncode = os.waitstatus_to_exitcode(status)
        return Run(run.returncode, used.ru_utime + used.ru_stime)
