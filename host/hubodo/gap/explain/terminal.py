"""Output of a gap result on a terminal."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from hubodo.gap.explain.descriptions import list_alternatives
from hubodo.gap.explain.explanation import Explanation
from hubodo.gap.explain.summary import (
    describe_confidence,
    describe_reduction,
    describe_runner_up,
    describe_verdict,
    format_parameters,
    format_probability,
    list_advice,
)
from hubodo.pages.console import print_table, print_text

if TYPE_CHECKING:
    from rich.console import Console

    from hubodo.gap.explain.missing_effects import MissingEffects

GAP_FILES = ("gap.json", "model.toml", "report.html")
_EFFECT_HEADINGS = ("effect", "scope", "parameters", "confidence", "gap", "held out")
_EXPLANATION_HEADINGS = ("round", "scope", "gain", "ln Bayes factor", "probability in the round", "beaten by")


def render_missing_effects(result: MissingEffects, console: Console) -> None:
    """Print the verdict, what to do next, the gap, the detected effects, and the remaining residual."""
    print_text(console, describe_verdict(result))
    for line in list_advice(result):
        print_text(console, f"→ {line}")
    gap, held_out = result.gap, result.held_out_gap
    noise_floor = "" if gap.floor is None else f" (noise alone: {gap.floor:.3f})"
    words = describe_reduction(gap.before, gap.after, gap.floor)
    print_text(console, f"gap {gap.before:.3f} → {gap.after:.3f}{noise_floor}{'; ' + words if words else ''}")
    print_text(console, f"held out {held_out.before:.3f} → {held_out.after:.3f}; {result.held_out_kind}")
    if result.found:
        print_table(console, _EFFECT_HEADINGS, _effect_rows(result))
    for finding in result.listed:
        print_text(console, f"{finding.effect}: {finding.where}")
        confidence = f"{describe_confidence(finding.confidence)} ({format_probability(finding.confidence)})"
        print_text(console, f"  {confidence}; {describe_runner_up(finding)}")
        if finding.inseparable_from:
            print_text(
                console,
                f"  not separable in this log from {', '.join(list_alternatives(finding.inseparable_from))}",
            )
    for residual in result.remaining:
        print_text(console, f"residual in {residual.channel}, {residual.where}: {residual.looks_like}")
    for explanation in result.explanations:
        print_text(console, explanation.summary)
        if explanation.rows:
            print_table(console, _EXPLANATION_HEADINGS, _explanation_rows(explanation), explanation.effect)
    for line in result.warnings:
        print_text(console, f"warning: {line}")
    if result.scaffold is not None:
        for line in result.scaffold.describe():
            print_text(console, line)
    elif result.scaffold_name is not None:
        print_text(
            console,
            f"--scaffold {result.scaffold_name}: the known effects explain the log; no new effect is needed",
        )
    if result.output is not None:
        print_text(console, ", ".join(str(Path(result.output) / name) for name in GAP_FILES))


def _effect_rows(result: MissingEffects) -> list[tuple[str, ...]]:
    return [
        (
            finding.effect,
            finding.scope,
            "\n".join(format_parameters(finding)),
            format_probability(finding.confidence),
            f"{finding.gap.before:.3f} → {finding.gap.after:.3f}",
            f"{finding.held_out_gap.before:.3f} → {finding.held_out_gap.after:.3f}",
        )
        for finding in result.listed
    ]


def _explanation_rows(explanation: Explanation) -> list[tuple[str, ...]]:
    return [
        (
            str(row.round),
            row.scope,
            f"{row.gain:.1f}",
            f"{row.evidence:.1f}",
            "not refitted" if row.probability is None else format_probability(row.probability),
            row.beaten_by,
        )
        for row in explanation.rows
    ]
