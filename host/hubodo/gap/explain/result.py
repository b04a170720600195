"""What a search found, as `gap.json` has it and as the report needs it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

from hubodo.effects.empirical import PREFIX
from hubodo.gap.judge.search import SearchResult
from hubodo.gap.process_noise.residual import Residual
from hubodo.model.model_file import Model

Verdict = Literal["no_gap", "explained", "partly_explained", "unexplained"]
# Of the form of gap.json, whose schema is gap.schema.json beside this file.
SCHEMA_VERSION = 1


@dataclass(frozen=True)
class BeforeAfter:
    """A gap before and after, in units of the declared noise. floor: what noise alone would leave."""

    before: float
    after: float
    floor: float | None = None

    def as_json(self) -> dict[str, float]:
        made = {"before": self.before, "after": self.after}
        return made if self.floor is None else {**made, "floor": self.floor}


@dataclass(frozen=True)
class Estimate:
    """A parameter: value, 1 sigma (None where the data do not see it), unit."""

    value: float
    sigma: float | None
    unit: str


@dataclass(frozen=True)
class Finding:
    """One effect that was found. effect: its name, or `empirical:` and the term. scope: a node, all, vehicle.

    p_value: how often the best of all candidates would gain as much by chance. rivals: what else was
    considered in its place, with its probability, the likeliest first.
    """

    effect: str
    scope: str
    parameters: Mapping[str, Estimate]
    gap: BeforeAfter
    held_out_gap: BeforeAfter
    p_value: float
    confidence: float
    where: str
    runner_up: tuple[str, float] | None
    inseparable_from: tuple[str, ...]
    rivals: tuple[tuple[str, str, float, float], ...]

    def as_json(self) -> dict[str, Any]:
        runner = self.runner_up
        return {
            "effect": self.effect,
            "scope": self.scope,
            "parameters": {
                name: {"value": it.value, "sigma": it.sigma, "unit": it.unit}
                for name, it in self.parameters.items()
            },
            "gap": self.gap.as_json(),
            "held_out_gap": self.held_out_gap.as_json(),
            "p_value": self.p_value,
            "confidence": self.confidence,
            "where": self.where,
            "runner_up": None if runner is None else {"effect": runner[0], "confidence": runner[1]},
            "inseparable_from": list(self.inseparable_from),
        }


@dataclass(frozen=True)
class Unexplained:
    """Structure that no effect explains: in which channel, where, and what it looks like."""

    channel: str
    where: str
    looks_like: str

    def as_json(self) -> dict[str, str]:
        return {"channel": self.channel, "where": self.where, "looks_like": self.looks_like}


@dataclass(frozen=True)
class GapResult:
    """The whole result.

    model: with what was added. steps: residuals at first and after each effect found. finished: whether the
    search came to its end.
    """

    verdict: Verdict
    gap: BeforeAfter
    held_out_gap: BeforeAfter
    held_out_kind: str
    found: tuple[Finding, ...]
    remaining: tuple[Unexplained, ...]
    warnings: tuple[str, ...]
    model: Model
    search: SearchResult
    residual_steps: tuple[Mapping[str, Residual], ...]
    is_finished: bool = True

    def as_json(self) -> dict[str, Any]:
        """`gap.json`, as its schema has it."""
        return {
            "version": SCHEMA_VERSION,
            "finished": self.is_finished,
            "verdict": self.verdict,
            "gap": self.gap.as_json(),
            "held_out_gap": self.held_out_gap.as_json(),
            "held_out": self.held_out_kind,
            "found": [finding.as_json() for finding in self.found],
            "remaining": [left.as_json() for left in self.remaining],
            "warnings": list(self.warnings),
        }


def split_by_channel(finding: Finding) -> list[Finding]:
    """An empirical effect as one entry for each channel that it adds to, `empirical:left.gz ~ term`."""
    channels, _, term = finding.effect.removeprefix(PREFIX).partition(" ~ ")
    made = []
    for channel in channels.split(","):
        own = {
            name.removeprefix(channel).lstrip("_") or "amplitude": value
            for name, value in finding.parameters.items()
            if name.partition("_")[0] == channel
        }
        effect = f"{PREFIX}{finding.scope}.{channel} ~ {term}"
        made.append(replace(finding, effect=effect, parameters=own))
    return made
