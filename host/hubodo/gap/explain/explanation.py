"""Explanation why an effect was not chosen: its gain and probability, by scope and round."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hubodo.effects import BY_NAME
from hubodo.gap.explain.summary import format_probability
from hubodo.gap.judge.round import Round

if TYPE_CHECKING:
    from hubodo.gap.explain.missing_effects import MissingEffects

_NO_WINNER = "no effect was significant"


@dataclass(frozen=True)
class ExplanationRow:
    """One scope of the effect in one round.

    gain: gain of the log-likelihood
    evidence: ln Bayes factor against the absence of the effect
    probability: None if it was not refitted
    beaten_by: the hypothesis that was added instead
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
    """Explanation of one effect: its name, one sentence, and one row per round and scope."""

    effect: str
    summary: str
    rows: tuple[ExplanationRow, ...]

    def as_json(self) -> dict[str, Any]:
        return {"effect": self.effect, "summary": self.summary, "rows": [row.as_json() for row in self.rows]}


def explain_effect(result: MissingEffects, name: str, is_rejected: bool = False) -> Explanation:
    """Explain why the effect `name` was or was not added; `is_rejected`: it was excluded by the user."""
    rows = [
        row
        for number, judged in enumerate(result.search.rounds, 1)
        for row in _list_rows(judged, number, name)
    ]
    return Explanation(name, _summarise(result, name, rows, is_rejected), tuple(rows))


def _list_rows(judged: Round, number: int, name: str) -> list[ExplanationRow]:
    """Return the rows of one round."""
    best = judged.best
    winner = _NO_WINNER if best is None else f"{best.term.effect.name} ({best.term.scope})"
    rows, scopes = [], set()
    for hypothesis in judged.hypotheses:
        if hypothesis.term.effect.name == name:
            scopes.add(hypothesis.term.scope)
            beaten = "" if best is not None and best.key == hypothesis.key else winner
            rows.append(
                ExplanationRow(
                    number,
                    hypothesis.term.scope,
                    hypothesis.gain,
                    hypothesis.evidence,
                    hypothesis.probability,
                    beaten,
                )
            )
    for screened in judged.screened:
        term = screened.candidate.term
        # An effect with several seeds is listed more than once, the best first.
        if term.effect.name == name and term.scope not in scopes:
            scopes.add(term.scope)
            rows.append(ExplanationRow(number, term.scope, screened.gain, screened.evidence, None, winner))
    return rows


def _find_objection(rounds: Sequence[Round], name: str) -> str:
    """Return the reason why the last round that refitted an effect did not add it; "" if there was none."""
    for judged in reversed(rounds):
        hypotheses = [one for one in judged.hypotheses if one.term.effect.name == name]
        if hypotheses:
            best = max(hypotheses, key=lambda one: one.gain)
            would = f"{name} ({best.term.scope}) would gain {best.gain:.1f} in log-likelihood, but"
            if best.objection.startswith("not physical"):
                return f"{would} is {best.objection}"
            return f"{would} {best.objection}" if best.objection else ""
    return ""


def _summarise(result: MissingEffects, name: str, rows: list[ExplanationRow], is_rejected: bool) -> str:
    """Return one sentence on the outcome for the effect."""
    for finding in result.found:
        if finding.effect == name:
            return f"{name} is named ({finding.scope}), probability {format_probability(finding.confidence)}"
    if is_rejected:
        return f"{name} was not considered: --reject {name}"
    for finding in result.refined:
        if finding.effect == name:
            return f"{name} ({finding.scope}) of the model file changed by less than drives differ"
    if any(item.effect.name == name for item in result.model.effects):
        return f"{name} is in the model file already; this log requires no other value"
    objection = _find_objection(result.search.rounds, name)
    if objection:
        return objection
    lost = [(row, finding) for finding in result.found for row in finding.rivals if row[0] == name]
    if lost:
        (_, scope, gain, probability), finding = max(lost, key=lambda item: item[0][3])
        return (
            f"{name} ({scope}) lost to {finding.effect} ({finding.scope}) when each name was "
            f"reconsidered: gain {gain:.1f}, probability {format_probability(probability)} against "
            f"{format_probability(finding.confidence)}"
        )
    if not rows:
        if BY_NAME[name].visible_in == "scatter":
            return f"{name} was tested on the scatter of the samples; there is no sign of it"
        return f"{name} could not be tested: this log has no node that it could act on"
    refitted = [row for row in rows if row.probability is not None]
    best = max(refitted or rows, key=lambda row: row.gain)
    if not refitted:
        last = [row for row in rows if row.round == rows[-1].round]
        best = max(last, key=lambda row: row.evidence)
        shortfall = "less than its free parameters cost" if best.evidence <= 0.0 else "less than others gain"
        return (
            f"{name} was never among the best: in the last round it would gain {best.gain:.1f} in "
            f"log-likelihood ({best.scope}), {shortfall} (ln Bayes factor {best.evidence:.1f})"
        )
    if not best.beaten_by:
        return (
            f"{name} ({best.scope}) was added in round {best.round} and removed later: beside the effects "
            "added after it, or by chance, as much is gained without it"
        )
    if best.beaten_by == _NO_WINNER:
        return (
            f"{name} ({best.scope}) gained {best.gain:.1f} in log-likelihood, too little to be more than "
            f"chance: probability {format_probability(best.probability or 0.0)}"
        )
    return (
        f"{name} ({best.scope}) gained {best.gain:.1f} in log-likelihood in round {best.round} but "
        f"{best.beaten_by} explained it better: probability {format_probability(best.probability or 0.0)}"
    )
