"""Whether a test notices a mutant: those that execute it run, the cheapest first, until one fails."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

from mutants.executed import Executed
from mutants.operators import Mutant
from mutants.project_copy import ProjectCopy, Run

_FIRST, _MORE = 5.0, 6.0
"""Seconds of tests in the first process for a mutant, and how many times as much in each next one."""
_SLOWER, _PATIENCE = 10.0, 20.0
"""Times its processor time, and seconds beyond, after which a test is taken to hang."""
_LONG = 3600.0


@dataclass(frozen=True)
class Verdict:
    """killed_by: the test that failed, or the first of those of which one hangs; "" where none did.

    seconds: of the processor that it took.
    """

    killed_by: str
    seconds: float


class Judge:
    """Judges one mutant after the other in a copy of the project."""

    def __init__(self, copy: ProjectCopy, executed: Executed) -> None:
        self._copy = copy
        self._executed = executed
        self._folder = copy.root.parent

    def judge(self, mutant: Mutant, nearest: Sequence[str], budget: float) -> Verdict:
        """nearest: test files that import the changed one; all that there is for a line that no test executes
        in its own process, as firmware in MicroPython.
        """
        tests = self._executed.tests_of(mutant)
        spent = 0.0
        for chosen in _in_portions(tests, budget):
            limit = _PATIENCE + _SLOWER * sum(tests[test] for test in chosen)
            failed, seconds = self._failed(mutant, chosen, limit)
            spent += seconds
            if failed:
                return Verdict(failed, spent)
        for file in nearest if not tests else ():
            if spent >= budget:
                break
            failed, seconds = self._failed(mutant, [file], budget - spent)
            spent += seconds
            if failed:
                return Verdict(failed, spent)
        return Verdict("", spent)

    def fail_anyhow(self, tests: Collection[str]) -> set[str]:
        """Those that fail on the project as it is: they notice nothing. tests: ids, or files."""
        files = [test for test in tests if "::" not in test]
        found = {file for file in files if self._run([file], _LONG)[0].code not in (0, 5)}
        ids = sorted(test for test in tests if "::" in test)
        if ids:
            run, failed = self._run(ids, _LONG, "--maxfail=0")
            found |= set(ids if run.code not in (0, 1) else failed)
        return found

    def _failed(self, mutant: Mutant, tests: Sequence[str], limit: float) -> tuple[str, float]:
        """The test that notices the mutant, "" where none does; and the seconds that it took.

        A test whose time is known and that never ends has noticed it: the suite ends such a test. A whole
        file, whose time is not known, has not.
        """
        with self._copy.having(mutant):
            run, failed = self._run(tests, limit)
        if run.code in (0, 5) or (run.code < 0 and "::" not in tests[0]):
            return "", run.seconds
        return (failed[0] if failed else tests[0]), run.seconds

    def _run(self, tests: Sequence[str], limit: float, stop: str = "-x") -> tuple[Run, list[str]]:
        """And which failed. tests: their ids, or one file."""
        chosen, failed = self._folder / "chosen.json", self._folder / "failed.json"
        chosen.write_text(json.dumps([test for test in tests if "::" in test]), "utf-8")
        failed.write_text("[]", "utf-8")
        files = list(dict.fromkeys(test.partition("::")[0] for test in tests))
        arguments = [stop, "-p", "mutants.chosen", *files]
        run = self._copy.pytest(arguments, limit, MUTANTS_CHOSEN=str(chosen), MUTANTS_FAILED=str(failed))
        return run, json.loads(failed.read_text("utf-8"))


def _in_portions(tests: Mapping[str, float], budget: float) -> Iterator[list[str]]:
    """Tests for one process after the other: file by file, as tests of a file share what they need, the
    cheapest file first; and as long as the budget lasts.

    Many files take long to read: a first small portion mostly does.
    """
    files: dict[str, list[str]] = defaultdict(list)
    for test in sorted(tests, key=tests.__getitem__):
        files[test.partition("::")[0]].append(test)
    portion: list[str] = []
    size, filled, spent = _FIRST, 0.0, 0.0
    for ids in sorted(files.values(), key=lambda ids: sum(tests[test] for test in ids)):
        for test in ids:
            if spent >= budget:
                break
            portion.append(test)
            filled += tests[test]
            spent += tests[test]
            if filled >= size:
                yield portion
                portion, size, filled = [], size * _MORE, 0.0
    if portion:
        yield portion
