"""The result of a gap search: effects with sigmas, and the model with them added."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hubodo.api.arguments import StrPath, as_model
from hubodo.effects import BY_NAME
from hubodo.errors import InputError
from hubodo.gap.explain.result import Finding, GapResult
from hubodo.gap.explain.summary import describe_verdict, format_parameter, format_probability, list_advice
from hubodo.gap.judge.round import EMPIRICAL
from hubodo.gap.problem.assumed import assume_model
from hubodo.gap.workflow import find_gap
from hubodo.html_table import html_lines, html_table
from hubodo.model.model_file import Model
from hubodo.pages.drawing import new_figure
from hubodo.pages.page import COLOURS
from hubodo.pages.plot import Plot
from hubodo.progress import progress_line
from hubodo.report.gap_files import check_gap_folder, gap_file_contents, gap_json, write_files
from hubodo.spelling import suggest_spelling

if TYPE_CHECKING:
    from hubodo.api.log import LoadedLog


@dataclass(frozen=True, eq=False, repr=False)
class MissingEffects:
    """The effects that a model lacks to explain a log.

    Attributes
    ----------
    result : GapResult
        The complete result, with the residuals after each step and the rounds of the search.
    log : str
        Name of the log.
    given : str
        Name of the model.
    """

    result: GapResult
    log: str
    given: str

    @property
    def verdict(self) -> str:
        """Verdict: `no_gap`, `explained`, `partly_explained` or `unexplained`."""
        return self.result.verdict

    @property
    def found(self) -> tuple[Finding, ...]:
        """Detected effects in order of discovery: `effect`, `scope`, `parameters`, `confidence` and more."""
        return self.result.found

    @property
    def before(self) -> float:
        """Gap of the given model: rms residual in units of the declared noise."""
        return self.result.gap.before

    @property
    def after(self) -> float:
        """Gap of the model with the detected effects; noise alone gives 1."""
        return self.result.gap.after

    @property
    def model(self) -> Model:
        """The model with the detected effects added."""
        return self.result.model

    def as_json(self) -> dict[str, Any]:
        """Return the content of gap.json.

        Returns
        -------
        dict
            The JSON object.
        """
        return gap_json(self.result)

    def save(self, folder: StrPath) -> Path:
        """Write gap.json, model.toml and report.html, as `hubodo gap` does; an earlier result is replaced.

        Parameters
        ----------
        folder : str or path-like
            Folder for the files.

        Returns
        -------
        Path
            The folder.

        Raises
        ------
        InputError
            If the folder holds a model.toml that is no result of a gap search.
        """
        target = Path(folder)
        check_gap_folder(target, None)
        write_files(target, gap_file_contents(self.result, log=self.log, model=self.given))
        return target

    def plot(self) -> Plot:
        """Plot the gap after each added effect, on fitted and on held-out data.

        Returns
        -------
        Plot
            The figure.
        """
        result = self.result
        labels = ["as given", *(f"+ {finding.effect}\n{finding.scope}" for finding in result.found)]
        figure = new_figure(1.5 + 1.6 * len(labels), 3.6)
        axes = figure.subplots()
        fitted = [result.gap.before, *(finding.gap.after for finding in result.found)]
        held_out = [result.held_out_gap.before, *(finding.held_out_gap.after for finding in result.found)]
        for name, gaps, colour in (("fitted", fitted, "left"), ("held out", held_out, "fused")):
            axes.plot(labels, gaps, "o-", color=COLOURS[colour], label=name)
        if result.gap.floor is not None:
            axes.axhline(result.gap.floor, ls=":", color=COLOURS["truth"], label="noise alone")
        axes.set_ylabel("gap, in units of the noise")
        axes.legend(fontsize=9, frameon=False)
        return Plot(figure)

    def __repr__(self) -> str:
        names = ", ".join(f"{finding.effect} of {finding.scope}" for finding in self.found) or "nothing"
        return f"MissingEffects({self.verdict}: {names}; gap {self.before:.3f} → {self.after:.3f})"

    def _repr_html_(self) -> str:
        rows = [
            (
                finding.effect,
                finding.scope,
                ", ".join(format_parameter(name, value) for name, value in finding.parameters.items()),
                format_probability(finding.confidence),
                f"{finding.gap.before:.3f} → {finding.gap.after:.3f}",
            )
            for finding in self.found
        ]
        table = html_table(("effect", "scope", "parameters", "confidence", "gap"), rows) if rows else ""
        return html_lines((describe_verdict(self.result),)) + table + html_lines(list_advice(self.result))


def search_gap(
    log: LoadedLog, model: StrPath | Model | None, accept: Sequence[str], reject: Sequence[str]
) -> MissingEffects:
    """Search the effects that a model lacks to explain a log; see `LoadedLog.gap`."""
    check_effects(accept, reject)
    if model is not None:
        used_model = as_model(model)
    elif log.vehicle is not None:
        used_model = assume_model(log.recording, log.vehicle, str(log.path))
    else:
        raise InputError(f"{log.path}: holds no vehicle; give a model file")
    with progress_line() as show:
        result = find_gap(
            log.recording,
            used_model,
            accept=accept,
            reject=reject,
            log_name=str(log.path),
            report_progress=show,
        )
    if not result.is_finished:
        raise KeyboardInterrupt("the search was interrupted")
    model_name = Path(model).name if isinstance(model, str | os.PathLike) else "the model"
    return MissingEffects(result, log.path.name, model_name)


def check_effects(accept: Iterable[str], reject: Iterable[str]) -> None:
    """Raise InputError for a name that is no effect."""
    for argument, names, known in (
        ("accept", accept, (*BY_NAME,)),
        ("reject", reject, (*BY_NAME, EMPIRICAL)),
    ):
        for name in names:
            if name not in known:
                hint = suggest_spelling(name, known) or f"; they are {', '.join(known)}"
                raise InputError(f"{argument} {name!r}: no such effect{hint}")
