"""Result of a gap search: effects with sigmas, the model with them added, JSON, text, figure, files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hubodo.gap.explain.explanation import Explanation
from hubodo.gap.explain.result import BeforeAfter, Finding, Unexplained, Verdict
from hubodo.gap.explain.scaffold import Scaffold
from hubodo.gap.explain.summary import describe_verdict, format_parameters, format_probability, list_advice
from hubodo.gap.explain.terminal import render_missing_effects
from hubodo.gap.explain.unnamed import merge_channels
from hubodo.gap.judge.search import SearchResult
from hubodo.gap.process_noise.residual import Residual
from hubodo.html_table import html_lines, html_table
from hubodo.model.model_file import Model
from hubodo.safe_text import json_value

if TYPE_CHECKING:
    import os

    from rich.console import Console

    from hubodo.pages.plot import Plot

# Version of gap.json; its schema is gap.schema.json beside this file.
SCHEMA_VERSION = 1


@dataclass(frozen=True, eq=False, repr=False)
class MissingEffects:
    """The effects that a model lacks to explain a log.

    Attributes
    ----------
    verdict : str
        `no_gap`, `explained`, `partly_explained` or `unexplained`.
    gap, held_out_gap : BeforeAfter
        Gap of the given model and of the one with the detected effects, on all and on held-out samples.
    held_out_kind : str
        The driving condition that was held out, as text.
    found : tuple of Finding
        Detected effects in order of discovery: `effect`, `scope`, `parameters`, `confidence` and more.
    remaining : tuple of Unexplained
        Residuals that no effect explains.
    warnings : tuple of str
        Remarks for the user.
    model : Model
        The model with the detected effects added.
    search : SearchResult
        All rounds of the search.
    residual_steps : tuple of mappings
        Residuals by channel at first and after each added effect.
    is_finished : bool
        False if the search was interrupted.
    refined : tuple of Finding
        Effects of the given model whose values changed by less than drives differ.
    log : str
        Name of the log.
    given : str
        Name of the given model.
    output : str or None
        Folder of gap.json, model.toml and report.html, if they were written.
    explanations : tuple of Explanation
        Reasons why other effects were not chosen, for `--explain`.
    scaffold : Scaffold or None
        The new effect written for `--scaffold`, if one was needed.
    scaffold_name : str or None
        The name given with `--scaffold`.
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
    refined: tuple[Finding, ...] = ()
    log: str = "log"
    given: str = "the model"
    output: str | None = None
    explanations: tuple[Explanation, ...] = ()
    scaffold: Scaffold | None = None
    scaffold_name: str | None = None

    @property
    def before(self) -> float:
        """Return the gap of the given model: rms residual in units of the declared noise."""
        return self.gap.before

    @property
    def after(self) -> float:
        """Return the gap of the model with the detected effects; noise alone gives 1."""
        return self.gap.after

    @property
    def listed(self) -> list[Finding]:
        """Return the detected effects as people read them: the channels of an unnamed term are one."""
        return merge_channels(self.found)

    @property
    def failed(self) -> bool:
        """Return True if `--scaffold` was given and no unexplained dependence was found."""
        return self.scaffold_name is not None and self.scaffold is None

    def as_json(self) -> dict[str, Any]:
        """Return the content of gap.json, with the explanations and the scaffold, if there are any.

        Returns
        -------
        dict
            The JSON object; non-finite numbers are None.
        """
        content: dict[str, Any] = {
            "version": SCHEMA_VERSION,
            "finished": self.is_finished,
            "verdict": self.verdict,
            "gap": self.gap.as_json(),
            "held_out_gap": self.held_out_gap.as_json(),
            "held_out": self.held_out_kind,
            "found": [finding.as_json() for finding in self.found],
            "refined": [finding.as_json() for finding in self.refined],
            "remaining": [structure.as_json() for structure in self.remaining],
            "warnings": list(self.warnings),
        }
        if self.explanations:
            content["explain"] = [explanation.as_json() for explanation in self.explanations]
        if self.scaffold is not None:
            content["scaffold"] = self.scaffold.as_json()
        return {key: json_value(value) for key, value in content.items()}

    def save(self, folder: str | os.PathLike[str]) -> Path:
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
        from hubodo.gap.explain.files import check_gap_folder, gap_file_contents, write_files

        target = Path(folder)
        check_gap_folder(target, None)
        write_files(target, gap_file_contents(self))
        return target

    def render(self, console: Console) -> None:
        """Print the verdict, what to do next, the gap, the detected effects, and the remaining residual.

        Parameters
        ----------
        console : rich.console.Console
            The console to print to.
        """
        render_missing_effects(self, console)

    def plot(self) -> Plot:
        """Plot the gap after each added effect, on fitted and on held-out data.

        Returns
        -------
        Plot
            The figure.
        """
        from hubodo.pages.drawing import new_figure
        from hubodo.pages.page import COLOURS
        from hubodo.pages.plot import Plot

        labels = ["as given", *(f"+ {finding.effect}\n{finding.scope}" for finding in self.listed)]
        figure = new_figure(1.5 + 1.6 * len(labels), 3.6)
        axes = figure.subplots()
        fitted = [self.gap.before, *(finding.gap.after for finding in self.listed)]
        held_out = [self.held_out_gap.before, *(finding.held_out_gap.after for finding in self.listed)]
        for name, gaps, colour in (("fitted", fitted, "left"), ("held out", held_out, "fused")):
            axes.plot(labels, gaps, "o-", color=COLOURS[colour], label=name)
        if self.gap.floor is not None:
            axes.axhline(self.gap.floor, ls=":", color=COLOURS["truth"], label="noise alone")
        axes.set_ylabel("gap, in units of the noise")
        axes.legend(fontsize=9, frameon=False)
        return Plot(figure)

    def __repr__(self) -> str:
        names = ", ".join(f"{finding.effect} of {finding.scope}" for finding in self.listed) or "nothing"
        return f"MissingEffects({self.verdict}: {names}; gap {self.before:.3f} → {self.after:.3f})"

    def _repr_html_(self) -> str:
        rows = [
            (
                finding.effect,
                finding.scope,
                ", ".join(format_parameters(finding)),
                format_probability(finding.confidence),
                f"{finding.gap.before:.3f} → {finding.gap.after:.3f}",
            )
            for finding in self.listed
        ]
        table = html_table(("effect", "scope", "parameters", "confidence", "gap"), rows) if rows else ""
        return html_lines((describe_verdict(self),)) + table + html_lines(list_advice(self))
