"""What `hubodo gap` found, as Python programs use it: names with sigmas, and the model with them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hubodo.api.given import StrPath
from hubodo.api.plot import Plot
from hubodo.effects import BY_NAME
from hubodo.errors import InputError
from hubodo.gap.explain.result import Finding, GapResult
from hubodo.gap.explain.summary import describe_verdict, format_probability, format_with_sigma, list_advice
from hubodo.gap.judge.round import EMPIRICAL
from hubodo.html_table import html_lines, html_table
from hubodo.model.model_file import Model
from hubodo.report.drawing import blank
from hubodo.report.gap_files import check_gap_folder, gap_contents, gap_json, write_texts
from hubodo.report.page import COLOURS
from hubodo.toml_file import suggest_spelling


@dataclass(frozen=True, eq=False, repr=False)
class MissingEffects:
    """What a model lacks to explain a log.

    Attributes:
        result: everything: the residuals after each step, the rounds of the search.
        log: what the log is called.
        given: what the model is called.
    """

    result: GapResult
    log: str
    given: str

    @property
    def verdict(self) -> str:
        """`no_gap`, `explained`, `partly_explained` or `unexplained`."""
        return self.result.verdict

    @property
    def found(self) -> tuple[Finding, ...]:
        """The effects in order of discovery: `effect`, `scope`, `parameters`, `confidence`, and so on."""
        return self.result.found

    @property
    def before(self) -> float:
        """The gap of the model as it was given, in units of the declared noise."""
        return self.result.gap.before

    @property
    def after(self) -> float:
        """The gap of the model with what was found; noise alone leaves 1."""
        return self.result.gap.after

    @property
    def model(self) -> Model:
        """The model with what was found."""
        return self.result.model

    def as_json(self) -> dict[str, Any]:
        """What gap.json holds."""
        return gap_json(self.result)

    def save(self, folder: StrPath) -> Path:
        """Write gap.json, model.toml and report.html, as `hubodo gap` does; an earlier result is replaced.

        Raises InputError for a folder whose model.toml is no result.
        """
        target = Path(folder)
        check_gap_folder(target, None)
        write_texts(target, gap_contents(self.result, log=self.log, model=self.given))
        return target

    def plot(self) -> Plot:
        """The gap after each effect, on what was fitted and on what was not."""
        result = self.result
        labels = ["as given", *(f"+ {it.effect}\n{it.scope}" for it in result.found)]
        figure = blank(1.5 + 1.6 * len(labels), 3.6)
        axes = figure.subplots()
        for name, first, then, colour in (
            ("fitted", result.gap.before, [it.gap.after for it in result.found], "left"),
            ("held out", result.held_out_gap.before, [it.held_out_gap.after for it in result.found], "fused"),
        ):
            axes.plot(labels, [first, *then], "o-", color=COLOURS[colour], label=name)
        if result.gap.floor is not None:
            axes.axhline(result.gap.floor, ls=":", color=COLOURS["truth"], label="noise alone")
        axes.set_ylabel("gap, in units of the noise")
        axes.legend(fontsize=9, frameon=False)
        return Plot(figure)

    def __repr__(self) -> str:
        names = ", ".join(f"{it.effect} of {it.scope}" for it in self.found) or "nothing"
        return f"MissingEffects({self.verdict}: {names}; gap {self.before:.3f} → {self.after:.3f})"

    def _repr_html_(self) -> str:
        rows = [
            (
                it.effect,
                it.scope,
                ", ".join(
                    f"{name} {format_with_sigma(value.value, value.sigma)} "
                    f"{'' if value.unit == '1' else value.unit}"
                    for name, value in it.parameters.items()
                ),
                format_probability(it.confidence),
                f"{it.gap.before:.3f} → {it.gap.after:.3f}",
            )
            for it in self.found
        ]
        table = html_table(("effect", "of", "parameters", "confidence", "gap"), rows) if rows else ""
        return html_lines((describe_verdict(self.result),)) + table + html_lines(list_advice(self.result))


def check_effects(accept: Iterable[str], reject: Iterable[str]) -> None:
    """Raises InputError for a name that is none of an effect."""
    for said, names, known in (("accept", accept, (*BY_NAME,)), ("reject", reject, (*BY_NAME, EMPIRICAL))):
        for name in names:
            if name not in known:
                hint = suggest_spelling(name, known) or f"; they are {', '.join(known)}"
                raise InputError(f"{said} {name!r}: no such effect{hint}")
