"""What one check of a board has found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

Verdict = Literal["ok", "wrong", "unknown"]

CHECKS = {
    "port": "",
    "speech": "nothing was heard",
    "MicroPython": "a node runs; --repl interrupts it and looks",
    "wires": "a node runs; --repl interrupts it and looks",
    "files": "a node runs; --repl interrupts it and looks",
    "hello": "no node runs",
    "sensor": "no node runs",
    "power": "no report of the node's health came",
    "samples": "no node runs",
    "rest": "no samples came",
    "clock": "no node runs",
    "link": "no node runs",
}
"""The checks in bring-up order, and why one was left out unless something is wrong before it."""


@dataclass(frozen=True)
class CheckResult:
    """check: a key of CHECKS. seen: what was there. remedy: what to do about it, or ""."""

    check: str
    verdict: Verdict
    seen: str
    remedy: str = ""

    def as_json(self) -> dict[str, Any]:
        return {"check": self.check, "verdict": self.verdict, "seen": self.seen, "remedy": self.remedy}


def ok(check: str, seen: str) -> CheckResult:
    return CheckResult(check, "ok", seen)


def wrong(check: str, seen: str, remedy: str) -> CheckResult:
    return CheckResult(check, "wrong", seen, remedy)


def unknown(check: str, seen: str, remedy: str = "") -> CheckResult:
    return CheckResult(check, "unknown", seen, remedy)
