"""A copy of the project in which tests are run with one mutant at a time."""

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
MAX_WALL_TIME_FACTOR = 10.0
"""A run is killed after this many times its limit of CPU time."""


@dataclass(frozen=True)
class Run:
    """The result of a run of pytest.

    code: exit code, negative if it was killed at its time limit
    seconds: CPU time
    """

    code: int
    seconds: float


class ProjectCopy:
    """A copy of all files tracked by git, as in the working tree."""

    def __init__(self, folder: Path) -> None:
        self.root = folder / "hubodo"
        git_listing = subprocess.run(
            ["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True, text=True
        )
        for name in filter(None, git_listing.stdout.split("\0")):
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
    def apply_mutant(self, mutant: Mutant) -> Iterator[None]:
        """Apply a mutant to its file within a `with` block.

        Each version of the file has its own modification time, so that byte code of another version is never
        used.
        """
        file = self.root / mutant.path
        original, modification_time = file.read_bytes(), file.stat().st_mtime_ns
        self._versions += 1
        file.write_bytes(original[: mutant.start] + mutant.new.encode() + original[mutant.end :])
        os.utime(file, (self._versions, self._versions))
        try:
            yield
        finally:
            file.write_bytes(original)
            os.utime(file, ns=(modification_time, modification_time))

    def pytest(self, arguments: Sequence[str], limit: float, **environment: str) -> Run:
        """Run pytest without tests marked `real_time`.

        limit: CPU time, s, enforced by `chosen.py`
        """
        run = subprocess.Popen(
            [sys.executable, "-m", "pytest", "-m", "not real_time", "-p", "no:cacheprovider", *arguments],
            cwd=self.root,
            env={**self._environment, **environment, "MUTANTS_SECONDS": str(limit)},
            start_new_session=True,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        kill_timer = threading.Timer(MAX_WALL_TIME_FACTOR * limit, os.killpg, (run.pid, signal.SIGKILL))
        kill_timer.start()
        _, status, usage = os.wait4(run.pid, 0)
        kill_timer.cancel()
        run.returncode = os.waitstatus_to_exitcode(status)
        return Run(run.returncode, usage.ru_utime + usage.ru_stime)
