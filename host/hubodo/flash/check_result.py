"""The result of one check of a board."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

Verdict = Literal["ok", "wrong", "unknown"]

CHECKS = {
    "port": "",
    "protocol": "nothing was received",
    "MicroPython": "a node is running; --repl interrupts it to check",
    "wiring": "a node is running; --repl interrupts it to check",
    "files": "a node is running; --repl interrupts it to check",
    "identification": "no node is running",
    "sensor": "no node is running",
    "power": "no health message received",
    "samples": "no node is running",
    "standstill": "no samples received",
    "clock": "no node is running",
    "link": "no node is running",
}
"""Checks in bring-up order, with the reason for "unknown" if no earlier check failed.

The keys are the names that people see; `_JSON_NAMES` holds those in `--json` where they differ.
"""


_JSON_NAMES = {"protocol": "speech", "identification": "hello", "wiring": "wires", "standstill": "rest"}


@dataclass(frozen=True)
class CheckResult:
    """The result of one check.

    Attributes
    ----------
    check
        A key of CHECKS.
    verdict
        ok, wrong or unknown.
    observation
        What was observed, in one line.
    remedy
        What to do, or "".
    """

    check: str
    verdict: Verdict
    observation: str
    remedy: str = ""

    def as_json(self) -> dict[str, Any]:
        """Return the JSON form: `check` is the established key, `name` the name that people see."""
        return {
            "check": _JSON_NAMES.get(self.check, self.check),
            "name": self.check,
            "verdict": self.verdict,
            "seen": self.observation,
            "remedy": self.remedy,
        }


def passed_check(check: str, observation: str) -> CheckResult:
    """Return a passed check."""
    return CheckResult(check, "ok", observation)


def failed_check(check: str, observation: str, remedy: str) -> CheckResult:
    """Return a failed check."""
    return CheckResult(check, "wrong", observation, remedy)


def unknown_check(check: str, observation: str, remedy: str = "") -> CheckResult:
    """Return a check without a verdict."""
    return CheckResult(check, "unknown", observation, remedy)
