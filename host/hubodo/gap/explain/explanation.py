"""Why an effect was not chosen: its gain and probability beside what won, scope by scope, round by round."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hubodo.effects import BY_NAME
from hubodo.gap.explain.result import GapResult
from hubodo.gap.explain.summary import format_probability
from hubodo.gap.judge.round import Round


@dataclass(frozen=True)
class ExplanationRow:
    """One scope of the effect in one round.

    gain: of the log-likelihood; evidence: ln Bayes factor against nothing. probability: None where it was not
    refitted.
    """

    round: int
    scope: str
    gain: float
    evidence: float
    probability: float | None
    beaten_by: str

    def as_json(self) -> dict[str, Any]:
        return {
            "round": self.round,
            "scope": self.scope,
            "gain": self.gain,
            "evidence": self.evidence,
            "probability": self.probability,
            "beaten_by": self.beaten_by,
        }


@dataclass(frozen=True)
class Explanation:
    """effect: its name. summary: one sentence. rows: as the search saw it."""

    effect: str
    summary: str
    rows: tuple[ExplanationRow, ...]

    def as_json(self) -> dict[str, Any]:
        return {"effect": self.effect, "summary": self.summary, "rows": [row.as_json() for row in self.rows]}


def explain_effect(result: GapResult, name: str, is_rejected: bool = False) -> Explanation:
    """Why the effect `name` is not in `found`, or why it is. rejected: it was not to be considered."""
    rows = [
        row for number, made in enumerate(result.search.rounds, 1) for row in _list_rows(made, number, name)
    ]
    return Explanation(name, _summarise(result, name, rows, is_rejected), tuple(rows))


def _list_rows(made: Round, number: int, name: str) -> list[ExplanationRow]:
    best = made.best
    winner = "nothing earned its place" if best is None else f"{best.term.effect.name} ({best.term.scope})"
    rows, seen = [], set()
    for rival in made.hypotheses:
        if rival.term.effect.name == name:
            seen.add(rival.term.scope)
            beaten = "" if best is not None and best.key == rival.key else winner
            rows.append(
                ExplanationRow(
                    number, rival.term.scope, rival.gain, rival.evidence, rival.probability, beaten
                )
            )
    for it in made.screened:
        term = it.candidate.term
        # An effect with several seeds stands there more than once; its best comes first.
        if term.effect.name == name and term.scope not in seen:
            seen.add(term.scope)
            rows.append(ExplanationRow(number, term.scope, it.gain, it.evidence, None, winner))
    return rows


def _summarise(result: GapResult, name: str, rows: list[ExplanationRow], is_rejected: bool) -> str:
    for finding in result.found:
        if finding.effect == name:
            return f"{name} was found ({finding.scope}), probability {format_probability(finding.confidence)}"
    if is_rejected:
        return f"{name} was not considered: --reject {name}"
    if any(item.effect.name == name for item in result.model.effects):
        return f"{name} is in the model file already; its values there stay as they are"
    for finding in result.found:
        for effect, scope, gain, share in finding.rivals:
            if effect == name:
                return (
                    f"{name} ({scope}) lost to {finding.effect} ({finding.scope}) when each name was "
                    f"reconsidered: gain {gain:.1f}, probability {format_probability(share)} against "
                    f"{format_probability(finding.confidence)}"
                )
    if not rows:
        if BY_NAME[name].visible_in == "scatter":
            return f"{name} was looked for in how the samples scatter; there is no sign of it"
        return f"{name} could not be tested: this log has no node that it could act on"
    refitted = [row for row in rows if row.probability is not None]
    best = max(refitted or rows, key=lambda row: row.gain)
    if not refitted:
        last = [row for row in rows if row.round == rows[-1].round]
        best = max(last, key=lambda row: row.evidence)
        worth = "less than the freedom it takes" if best.evidence <= 0.0 else "less than others bring"
        return (
            f"{name} was never among the best: in the last round it would gain {best.gain:.1f} in "
            f"log-likelihood ({best.scope}), {worth} (ln Bayes factor {best.evidence:.1f})"
        )
    if not best.beaten_by:
        return (
            f"{name} ({best.scope}) was added in round {best.round} and taken out again: beside what came "
            "later, or by chance in what the finished model leaves, as much is gained without it"
        )
    if best.beaten_by == "nothing earned its place":
        return (
            f"{name} ({best.scope}) gained {best.gain:.1f} in log-likelihood, too little to be more than "
            f"chance: probability {format_probability(best.probability or 0.0)}"
        )
    return (
        f"{name} ({best.scope}) gained {best.gain:.1f} in log-likelihood in round {best.round} but "
        f"{best.beaten_by} explained it better: probability {format_probability(best.probability or 0.0)}"
    )
