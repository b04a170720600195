"""Judgement of a mutant: the tests that execute it are run, fastest first, until one fails."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

from mutants.executed import LineCoverage
from mutants.operators import Mutant
from mutants.project_copy import ProjectCopy, Run

_FIRST_BATCH_S, _BATCH_GROWTH = 5.0, 6.0
"""Duration of the tests in the first process, s, and the growth factor for each further process."""
_TIMEOUT_FACTOR, _TIMEOUT_MARGIN_S = 10.0, 20.0
"""A test that takes longer than factor times its recorded CPU time plus margin is taken to hang."""
_CHECK_TIMEOUT_S = 3600.0


@dataclass(frozen=True)
class Verdict:
    """The verdict on a mutant.

    killed_by: the test that failed, or the first one of a batch that hangs; "" if the mutant survived
    seconds: CPU time of the tests
    """

    killed_by: str
    seconds: float


class Judge:
    """A judge of mutants in one copy of the project."""

    def __init__(self, copy: ProjectCopy, coverage: LineCoverage) -> None:
        self._copy = copy
        self._coverage = coverage
        self._folder = copy.root.parent

    def judge(self, mutant: Mutant, nearest: Sequence[str], budget: float) -> Verdict:
        """Run tests on a mutant until one fails or the budget is exceeded, and return the verdict.

        nearest: test files that import the changed file; they are used for lines that no test executes in its
            own process, such as firmware run by MicroPython
        budget: CPU time, s
        """
        tests = self._coverage.tests_of(mutant)
        spent_s = 0.0
        for test_ids in _split_into_batches(tests, budget):
            limit = _TIMEOUT_MARGIN_S + _TIMEOUT_FACTOR * sum(tests[test] for test in test_ids)
            failed, seconds = self._find_killer(mutant, test_ids, limit)
            spent_s += seconds
            if failed:
                return Verdict(failed, spent_s)
        for file in nearest if not tests else ():
            if spent_s >= budget:
                break
            failed, seconds = self._find_killer(mutant, [file], budget - spent_s)
            spent_s += seconds
            if failed:
                return Verdict(failed, spent_s)
        return Verdict("", spent_s)

    def find_failing_tests(self, tests: Collection[str]) -> set[str]:
        """Return the tests that fail without a mutant.

        tests: ids of tests, or files
        """
        files = [test for test in tests if "::" not in test]
        failing = {file for file in files if self._run([file], _CHECK_TIMEOUT_S)[0].code not in (0, 5)}
        ids = sorted(test for test in tests if "::" in test)
        if ids:
            run, failed = self._run(ids, _CHECK_TIMEOUT_S, "--maxfail=0")
            failing |= set(ids if run.code not in (0, 1) else failed)
        return failing

    def _find_killer(self, mutant: Mutant, tests: Sequence[str], limit: float) -> tuple[str, float]:
        """Return the test that fails on the mutant, or "", and the CPU time in s.

        A test of known duration that does not end counts as failed, as the suite has a timeout. A file of
        unknown duration that does not end does not count.
        """
        with self._copy.apply_mutant(mutant):
            run, failed = self._run(tests, limit)
        if run.code in (0, 5) or (run.code < 0 and "::" not in tests[0]):
            return "", run.seconds
        return (failed[0] if failed else tests[0]), run.seconds

    def _run(self, tests: Sequence[str], limit: float, stop: str = "-x") -> tuple[Run, list[str]]:
        """Run tests and return the run and the failed tests.

        tests: ids, or one file
        """
        test_ids, failed = self._folder / "chosen.json", self._folder / "failed.json"
        test_ids.write_text(json.dumps([test for test in tests if "::" in test]), "utf-8")
        failed.write_text("[]", "utf-8")
        files = list(dict.fromkeys(test.partition("::")[0] for test in tests))
        arguments = [stop, "-p", "mutants.chosen", *files]
        run = self._copy.pytest(arguments, limit, MUTANTS_CHOSEN=str(test_ids), MUTANTS_FAILED=str(failed))
        return run, json.loads(failed.read_text("utf-8"))


def _split_into_batches(tests: Mapping[str, float], budget: float) -> Iterator[list[str]]:
    """Yield batches of tests within the budget, each for one process, the fastest files first.

    Tests of a file stay together, as they share fixtures. The first batch is small, as it mostly suffices and
    importing many files is slow.
    """
    files: dict[str, list[str]] = defaultdict(list)
    for test in sorted(tests, key=tests.__getitem__):
        files[test.partition("::")[0]].append(test)
    batch: list[str] = []
    batch_limit_s, batch_s, spent_s = _FIRST_BATCH_S, 0.0, 0.0
    for ids in sorted(files.values(), key=lambda ids: sum(tests[test] for test in ids)):
        for test in ids:
            if spent_s >= budget:
                break
            batch.append(test)
            batch_s += tests[test]
            spent_s += tests[test]
            if batch_s >= batch_limit_s:
                yield batch
                batch, batch_limit_s, batch_s = [], batch_limit_s * _BATCH_GROWTH, 0.0
    if batch:
        yield batch
