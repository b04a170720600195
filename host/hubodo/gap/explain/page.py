"""Page of a gap result: verdict, missing effects and recommendations, then figures and evidence."""

from __future__ import annotations

import html
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hubodo.gap.explain.descriptions import list_alternatives
from hubodo.gap.explain.figures import (
    Channel,
    evidence_figure,
    gap_over_time_figure,
    regime_figure,
    residual_figure,
    select_channels,
    steps_figure,
)
from hubodo.gap.explain.indistinguishable import INDISTINGUISHABLE_CAUSES
from hubodo.gap.explain.recommended_drive import drive_figure, recommend_drives, slider_figure
from hubodo.gap.explain.regimes import compute_trajectory
from hubodo.gap.explain.reliability import RELIABILITY
from hubodo.gap.explain.result import BeforeAfter, Finding
from hubodo.gap.explain.summary import (
    describe_confidence,
    describe_effect,
    describe_reduction,
    describe_runner_up,
    describe_verdict,
    format_parameters,
    format_probability,
    list_advice,
)
from hubodo.gap.problem.problem import CHANNELS
from hubodo.pages.page import PageTable, Section, render_page

if TYPE_CHECKING:
    from hubodo.gap.explain.missing_effects import MissingEffects

_GAP_STYLE = """<style>
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(15rem, 1fr)); gap: 0.9rem; }
.card { border: 1px solid var(--line); border-radius: 10px; padding: 0.8rem 1rem; }
.card h3 { margin: 0 0 0.3rem; font-size: 0.9rem; color: var(--dim); font-weight: 600; }
.card p { margin: 0.4rem 0 0; font-size: 0.9rem; } .card .dim { font-size: 0.82rem; }
.big { font-size: 1.9rem; font-weight: 650; font-variant-numeric: tabular-nums; line-height: 1.2; }
.big small { color: var(--dim); font-weight: 400; }
.meter { height: 0.55rem; border-radius: 99px; background: var(--line); margin-top: 0.5rem;
  overflow: hidden; }
.meter i { display: block; height: 100%; border-radius: 99px; background: #1b6ca8; }
.missing { border-left: 5px solid #1b6ca8; margin: 0.9rem 0; } .missing.fine { border-left-color: #2e7d5b; }
.missing.warning { border-left-color: #a66a00; }
.missing b { font-size: 1.12rem; } code { font-size: 0.92em; }
.badge { display: inline-block; border-radius: 99px; padding: 0.1rem 0.8rem; font-size: 0.85rem;
  font-weight: 650; color: #fff; margin-bottom: 0.6rem; }
ul.todo { margin: 0.3rem 0 0; padding-left: 1.2rem; }
@media print { .card, .figure, table { break-inside: avoid; } h2 { break-after: avoid; }
  .badge, .meter, .meter i { print-color-adjust: exact; } pre { white-space: pre-wrap; } }
</style>"""
_BADGES = {
    "no_gap": ("no gap", "#2e7d5b"),
    "explained": ("explained", "#1b6ca8"),
    "partly_explained": ("partly explained", "#4a6a8a"),
    "unexplained": ("unexplained", "#5d5480"),
}


def gap_page(result: MissingEffects, written: str) -> str:
    """Return the page as HTML; written: text of the model file with the added effects."""
    channels = select_channels(result)
    trajectories = {
        name: compute_trajectory(residual.node) for name, residual in result.residual_steps[0].items()
    }
    sections = [
        Section(
            "The gap, step by step",
            "The gap is the rms of the residuals in units of the noise declared in the model file: a "
            "perfect model "
            "has 1, or the value of the dotted line if the noise is not as declared. Held out of the fit: "
            f"{result.held_out_kind}.",
            [_steps_table(result)] if result.found else [],
            [steps_figure(result)] if result.found else [],
        ),
        Section(
            "Residuals before and after" if result.found else "Residuals",
            "Measured minus predicted, in the channels with the largest changes.",
            figures=[residual_figure(result, channels)] if channels else [],
        ),
        *_step_by_step(result, channels),
        Section(
            "Dependence of the residuals",
            "The same residuals, averaged over the quantity on which they depend most. For a complete "
            "model they are "
            "flat lines at zero.",
            figures=[regime_figure(result, channels, trajectories)] if channels else [],
        ),
        Section(
            "Gap over time", "The gap of all channels along the log.", figures=[gap_over_time_figure(result)]
        ),
        *(_evidence(finding) for finding in result.listed),
        Section(
            "All channels",
            "Root mean square of the residuals in units of the declared noise. Noise: variation from "
            "sample to "
            "sample, which no effect explains.",
            [_channel_table(result)],
        ),
        _remaining(result),
        *_drive_this(result),
        *_limits_of_names(),
        Section(
            "Resulting model",
            "The file model.toml in the folder of this page; it can be used as any model file.",
            listing=written,
        ),
    ]
    title = f"The gap between {result.given} and {result.log}"
    return render_page(title, describe_verdict(result), sections, _hero(result))


def _limits_of_names() -> list[Section]:
    """Return the section on how far names can be trusted, with causes that no drive distinguishes."""
    return [
        Section(
            "How far to trust a name",
            "Effects of known size were put into logs by code that shares nothing with the model. Real roads "
            "are harder than simulated ones.",
            [PageTable(("logs", "result", "not good yet"), RELIABILITY)],
        ),
        Section(
            "Indistinguishable causes",
            "Two causes with the same effect on every channel cannot be distinguished by any drive. An "
            "effect named on "
            "this page may be the other one of its pair.",
            [PageTable(("effect", "indistinguishable from", "reason"), INDISTINGUISHABLE_CAUSES)],
        ),
    ]


def _step_by_step(result: MissingEffects, channels: Sequence[Channel]) -> list[Section]:
    if not result.found or not channels:
        return []
    words = (
        "The mean residual of each second: grey for the given model, blue with the effects up to the slider."
    )
    return [Section("Effect by effect", words, figures=[slider_figure(result, channels)])]


def _drive_this(result: MissingEffects) -> list[Section]:
    """Return one section for each manoeuvre that would distinguish two effects."""
    return [
        Section(
            "Recommended drive",
            f"{words}. Example of the speed and yaw rate of such a drive:",
            figures=[drive_figure(estimate)],
        )
        for words, estimate in recommend_drives(result)
    ]


def _hero(result: MissingEffects) -> str:
    words, colour = _BADGES[result.verdict]
    parts = [_GAP_STYLE, f'<span class="badge" style="background:{colour}">{words}</span>']
    cards = [
        _gap_card("Gap on fitted data", result.gap, result.gap.floor),
        _gap_card("Gap on held-out data", result.held_out_gap, result.gap.floor),
        _confidence_card(result),
    ]
    parts.append(f'<div class="cards">{"".join(cards)}</div>')
    advice = "".join(f"<li>{html.escape(line)}</li>" for line in list_advice(result))
    parts.append(f'<div class="card missing fine"><h3>What to do</h3><ul class="todo">{advice}</ul></div>')
    parts += [_effect_card(finding) for finding in result.listed]
    if result.warnings:
        lines = "".join(f"<li>{html.escape(line)}</li>" for line in result.warnings)
        parts.append(
            f'<div class="card missing warning"><h3>Warnings</h3><ul class="todo">{lines}</ul></div>'
        )
    return "".join(parts)


def _gap_card(title: str, gap: BeforeAfter, floor: float | None) -> str:
    lowest = min(1.0 if floor is None else floor, gap.after)
    excess = gap.before**2 - lowest**2
    share = (gap.before**2 - gap.after**2) / excess if excess > 1e-9 else 0.0
    words = describe_reduction(gap.before, gap.after, floor)
    description = html.escape(words or "no part of the gap was explained")
    width = 100.0 * min(max(share, 0.0), 1.0)
    meter = f'<div class="meter"><i style="width:{width:.0f}%"></i></div>' if words else ""
    floor_text = "" if floor is None else f"; noise alone gives {floor:.2f} here"
    return (
        f'<div class="card"><h3>{title}</h3><div class="big"><small>{_figure(gap.before)} →</small> '
        f"{_figure(gap.after)}</div>{meter}<p>{description}</p>"
        f'<p class="dim">1 is a perfect model{floor_text}</p></div>'
    )


def _figure(value: float) -> str:
    return f"{value:.1f}" if value >= 20.0 else f"{value:.2f}" if value >= 1.5 else f"{value:.3f}"


def _confidence_card(result: MissingEffects) -> str:
    if not result.found:
        rounds = result.search.rounds
        nothing = rounds[-1].null_probability if rounds else 1.0
        return (
            f'<div class="card"><h3>Confidence</h3><div class="big">{format_probability(nothing)}</div>'
            f"<p>that no known effect is missing</p></div>"
        )
    weakest = min(result.found, key=lambda finding: finding.confidence)
    remark = ", the lowest of all names" if len(result.listed) > 1 else ""
    return (
        f'<div class="card"><h3>Confidence</h3>'
        f'<div class="big">{format_probability(weakest.confidence)}</div>'
        f"<p>{describe_confidence(weakest.confidence)}{remark}</p>"
        f'<p class="dim">{html.escape(describe_runner_up(weakest))}</p></div>'
    )


def _effect_card(finding: Finding) -> str:
    values = ", ".join(format_parameters(finding))
    indistinguishable = ""
    if finding.inseparable_from:
        others = html.escape(", ".join(list_alternatives(finding.inseparable_from)))
        indistinguishable = f"<p>Not distinguishable from {others} in this log.</p>"
    words = describe_effect(finding)
    return (
        f'<div class="card missing"><b>{html.escape(words[:1].upper() + words[1:])}</b> '
        f"<code>{html.escape(finding.effect)}</code><p>{html.escape(values)}</p>"
        f'<p class="dim">{html.escape(describe_confidence(finding.confidence))} '
        f"({format_probability(finding.confidence)}); {html.escape(describe_runner_up(finding))}; visible in "
        f"{html.escape(finding.where)}</p>{indistinguishable}</div>"
    )


def _steps_table(result: MissingEffects) -> PageTable:
    rows = [("model as given", "", _figure(result.gap.before), _figure(result.held_out_gap.before), "")]
    for finding in result.listed:
        values = ", ".join(format_parameters(finding))
        rows.append(
            (
                f"+ {finding.effect} ({finding.scope})",
                values,
                _figure(finding.gap.after),
                _figure(finding.held_out_gap.after),
                format_probability(finding.confidence),
            )
        )
    return PageTable(("model", "value ± 1σ", "gap", "held out", "confidence"), rows)


def _evidence(finding: Finding) -> Section:
    return Section(
        f"Evidence for {finding.effect}",
        "Every effect was tested in every scope and the best were fitted fully. The probabilities follow "
        "from the "
        "likelihoods, with a penalty for free parameters. Gain: increase of the log likelihood.",
        figures=[evidence_figure(finding)],
    )


def _channel_table(result: MissingEffects) -> PageTable:
    first, last = result.residual_steps[0], result.residual_steps[-1]
    rows: list[tuple[str, ...]] = []
    for name, residual in first.items():
        for row in range(len(CHANNELS)):
            if not residual.node.used[row]:
                rows.append((f"{name}.{CHANNELS[row]}", "not measured", "", ""))
                continue
            values = (
                residual.value[row] / residual.declared_channel_sigma(row),
                last[name].value[row] / last[name].declared_channel_sigma(row),
                last[name].noise.channel_sigma(row) / last[name].declared_channel_sigma(row),
            )
            sizes = (f"{float(np.sqrt(np.mean(value**2))):.3f}" for value in values)
            rows.append((f"{name}.{CHANNELS[row]}", *sizes))
    return PageTable(("channel", "before", "after", "noise"), rows)


def _remaining(result: MissingEffects) -> Section:
    if not result.remaining:
        return Section("Unexplained residuals", "None above the noise.")
    rows = [(remaining.channel, remaining.where, remaining.looks_like) for remaining in result.remaining]
    return Section("Unexplained residuals", "", [PageTable(("channel", "where", "looks like"), rows)])
