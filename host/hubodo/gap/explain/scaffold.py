"""The effect that `--scaffold` writes, as JSON and as text."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from hubodo.gap.explain.result import Estimate
from hubodo.gap.explain.summary import format_with_sigma


@dataclass(frozen=True)
class Scaffold:
    """A new effect written for `--scaffold`.

    source: text of the effect's Python file
    where: channels and regimes that show it, in words
    parameters: fitted to the log
    replaced: effects that the new one makes unnecessary
    """

    name: str
    scope: str
    source: str
    where: str
    parameters: Mapping[str, Estimate]
    gap_before: float
    gap_after: float
    replaced: tuple[str, ...]

    def describe(self) -> list[str]:
        """Return the result, one line each."""
        values = ", ".join(
            f"{key} {format_with_sigma(estimate.value, estimate.sigma)} {estimate.unit}"
            for key, estimate in self.parameters.items()
        )
        lines = [f"{self.name} ({self.scope}): {values}", f"  {self.where}"]
        lines.append(
            f"  gap {self.gap_before:.3f} → {self.gap_after:.3f}; use it with --effects {self.name}.py"
        )
        if self.replaced:
            lines.append(f"  it replaces {', '.join(self.replaced)}")
        return lines

    def as_json(self) -> dict[str, Any]:
        """Return the result as JSON."""
        return {
            "effect": self.name,
            "scope": self.scope,
            "parameters": {key: estimate.as_json() for key, estimate in self.parameters.items()},
            "where": self.where,
            "gap": {"before": self.gap_before, "after": self.gap_after},
            "replaced": list(self.replaced),
        }
