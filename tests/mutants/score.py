"""Mutation testing of the core: small mistakes put into it one at a time, and whether a test notices.

    python tests/mutants/score.py [--seed 1] [--count 125] [--only fuse gap] [--budget 120] [--jobs 2]

Of all places of the core `--count` are drawn by the seed. For each, the test files that reach the changed
file run, nearest first, in a copy of the project, until one fails or the budget is spent: what nobody noticed
until then has survived. The budget is seconds of processor time, so that a busy computer does not change the
score. What waits for the clock is left out.
"""

from __future__ import annotations

import argparse
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue

ROOT = Path(__file__).resolve().parents[2]
WALL = 10.0
"""Times its processor time that a test may take; then it hangs."""
sys.path[:0] = [str(ROOT / "tests")]

from mutants.operators import Mutant, mutants  # noqa: E402
from mutants.reach import nearest_tests  # noqa: E402

CORE = {
    "effects": "host/hubodo/effects",
    "calibration": "host/hubodo/calibration",
    "model": "host/hubodo/model",
    "sensors": "host/hubodo/sensors",
    "fuse": "host/hubodo/fuse",
    "gap": "host/hubodo/gap",
    "node": "host/hubodo/ingest/node",
    "protocol": "protocol/hubowire",
    "firmware": "firmware",
}


@dataclass(frozen=True)
class Verdict:
    """killed_by: the test file that failed, "" where none did. seconds: of the processor that it took."""

    mutant: Mutant
    killed_by: str
    seconds: float


class Copy:
    """A copy of the project in which one mutant at a time lives."""

    def __init__(self, folder: Path) -> None:
        self.root = folder / "hubodo"
        listed = subprocess.run(
            ["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True, text=True
        )
        for name in filter(None, listed.stdout.split("\0")):
            target = self.root / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, target)
        for name in ("node_modules", ".venv"):
            (self.root / name).symlink_to(ROOT / name)
        self._fair: dict[str, bool] = {}
        path = f"{self.root / 'host'}{os.pathsep}{self.root / 'protocol'}"
        shared = os.environ.get("HUBODO_SHARED", str(ROOT.parent / "shared"))
        # Without byte code a change is seen even where it comes within the same second.
        self._environment = {
            **os.environ,
            "PYTHONPATH": path,
            "HUBODO_SHARED": shared,
            "PYTHONDONTWRITEBYTECODE": "1",
        }

    def judge(self, mutant: Mutant, tests: list[str], budget: float) -> Verdict:
        """Put the mutant in, run tests until one fails, take it out."""
        file = self.root / mutant.path
        sound = file.read_bytes()
        ill = sound[: mutant.start] + mutant.new.encode() + sound[mutant.end :]
        spent = 0.0
        for test in tests:
            if spent >= budget:
                break
            file.write_bytes(ill)
            try:
                passes, seconds = self._passes(test, budget - spent)
            finally:
                file.write_bytes(sound)
            spent += seconds
            if not passes and self._is_fair(test):
                return Verdict(mutant, test, spent)
        return Verdict(mutant, "", spent)

    def _is_fair(self, test: str) -> bool:
        """Whether a test file passes on the project as it is: one that fails anyhow notices nothing."""
        if test not in self._fair:
            self._fair[test], _ = self._passes(test, 600.0)
            if not self._fair[test]:
                print(f"{test} fails without any mutant: left out", file=sys.stderr)
        return self._fair[test]

    def _passes(self, test: str, budget: float) -> tuple[bool, float]:
        """Whether a test file passes, and its processor time; one that is not done by then has not failed."""
        command = [
            sys.executable,
            "-m",
            "pytest",
            "-x",
            "-m",
            "not real_time",
            "-p",
            "no:cacheprovider",
            test,
        ]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        limit = int(budget) + 1
        run = subprocess.Popen(
            command,
            cwd=self.root,
            env=self._environment,
            start_new_session=True,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (limit, limit)),
            **quiet,
        )
        hangs = threading.Timer(WALL * limit, os.killpg, (run.pid, signal.SIGKILL))
        hangs.start()
        _, status, used = os.wait4(run.pid, 0)
        hangs.cancel()
        run.returncode = code = os.waitstatus_to_exitcode(status)
        # 5: all of them wait for the clock. A negative one was killed for the time that it took.
        return code in (0, 5) or code < 0, used.ru_utime + used.ru_stime


def main() -> int:
    """Draws the mutants, judges them, prints the survivors and the score."""
    args = _arguments()
    files = [
        str(path.relative_to(ROOT))
        for name in args.only or CORE
        for path in sorted((ROOT / CORE[name]).rglob("*.py"))
    ]
    every = [mutant for path in files for mutant in mutants(path, (ROOT / path).read_text("utf-8"))]
    drawn = random.Random(args.seed).sample(every, min(args.count, len(every)))
    print(f"{len(drawn)} of {len(every)} mutants in {len(files)} files, seed {args.seed}", flush=True)
    reach = nearest_tests(ROOT, {mutant.path for mutant in drawn})
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        verdicts = _judge_all(drawn, reach, Path(folder), args.budget, args.jobs)
    survived = [verdict.mutant for verdict in verdicts if not verdict.killed_by]
    print("\nSurvived:" if survived else "\nNone survived.")
    for mutant in sorted(survived, key=str):
        print(f"  {mutant}")
    share = 1.0 - len(survived) / max(len(drawn), 1)
    print(f"killed {len(drawn) - len(survived)} of {len(drawn)}, {share:.0%}; seed {args.seed}")
    return int(share < args.demand)


def _judge_all(
    drawn: list[Mutant], reach: dict[str, list[str]], folder: Path, budget: float, jobs: int
) -> list[Verdict]:
    copies: SimpleQueue[Copy] = SimpleQueue()
    for number in range(jobs):
        copies.put(Copy(folder / str(number)))

    def judge(mutant: Mutant) -> Verdict:
        copy = copies.get()
        try:
            verdict = copy.judge(mutant, reach[mutant.path], budget)
        finally:
            copies.put(copy)
        told = f"killed by {verdict.killed_by}" if verdict.killed_by else "SURVIVED"
        print(f"{verdict.seconds:6.1f} s  {mutant}  {told}", flush=True)
        return verdict

    with ThreadPoolExecutor(jobs) as pool:
        return list(pool.map(judge, drawn))


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=125)
    parser.add_argument("--only", nargs="+", choices=list(CORE), help="these rooms")
    parser.add_argument(
        "--budget", type=float, default=120.0, help="processor seconds of tests for one mutant"
    )
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument(
        "--demand", type=float, default=0.0, help="share that must be killed, else exit code 1"
    )
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
