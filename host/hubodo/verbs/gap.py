"""`hubodo gap`: find the effects that a model lacks to explain a log."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table as TextTable

from hubodo.effects import BY_NAME
from hubodo.effects.loaded import name_problem
from hubodo.errors import InputError
from hubodo.gap.explain.explanation import Explanation, explain_effect
from hubodo.gap.explain.result import GapResult
from hubodo.gap.explain.summary import (
    describe_confidence,
    describe_reduction,
    describe_runner_up,
    describe_verdict,
    format_parameter,
    format_probability,
    list_advice,
)
from hubodo.gap.judge.journal import Journal, compute_fingerprint
from hubodo.gap.judge.round import EMPIRICAL, ReportProgress
from hubodo.gap.problem.assumed import assume_model
from hubodo.gap.problem.build import build_problem
from hubodo.gap.problem.problem import Problem
from hubodo.gap.scaffold.scaffold import Scaffold, build_scaffold
from hubodo.gap.workflow import find_problem_gap
from hubodo.log.any_log import read_log
from hubodo.log.roles import NODES_ROLE
from hubodo.model.model_file import Model, read_model
from hubodo.progress import progress_line
from hubodo.recording import Recording
from hubodo.report.gap_files import (
    GAP_FILES,
    check_gap_folder,
    gap_file_contents,
    gap_json,
    replace_non_finite,
    write_files,
)
from hubodo.spelling import suggest_spelling
from hubodo.vehicle import load_vehicle
from hubodo.verbs.effect_options import add_effects_option, register_effects
from hubodo.verbs.gap_arguments import check_argument_order
from hubodo.verbs.gap_change import ChangeReport, ReplacePositional, compare_logs
from hubodo.verbs.log_options import LOG_HELP, add_log_options, check_node_names, log_form
from hubodo.verbs.outputs import add_force_option
from hubodo.version import __version__

EXAMPLE = "hubodo gap model.toml drive.mcap -o gap/"
JOURNAL_FILE = "unfinished.jsonl"


@dataclass(frozen=True)
class GapReport:
    """The result of a gap search, and the folder that it was written to.

    Attributes
    ----------
    result
        The gap before and after, and the effects that were detected.
    output
        Folder of gap.json, model.toml and report.html.
    explanations
        Explanations for the effects of --explain.
    scaffold
        The effect written for --scaffold, if one was needed.
    scaffold_name
        The name given with --scaffold.
    """

    result: GapResult
    output: str
    explanations: tuple[Explanation, ...]
    scaffold: Scaffold | None = None
    scaffold_name: str | None = None

    @property
    def failed(self) -> bool:
        """Return True if --scaffold was given and no unexplained dependence was found."""
        return self.scaffold_name is not None and self.scaffold is None

    def as_json(self) -> dict[str, Any]:
        """Return the content of gap.json, with the explanations of --explain and the scaffold."""
        summary = gap_json(self.result)
        if self.explanations:
            summary["explain"] = replace_non_finite(
                [explanation.as_json() for explanation in self.explanations]
            )
        if self.scaffold is not None:
            summary["scaffold"] = replace_non_finite(self.scaffold.as_json())
        return summary

    def render(self, console: Console) -> None:
        """Print the verdict, what to do next, the gap, the detected effects, and the remaining residual."""
        result = self.result

        def print_line(text: str) -> None:
            console.print(text, highlight=False, markup=False, soft_wrap=True)

        print_line(describe_verdict(result))
        for line in list_advice(result):
            print_line(f"→ {line}")
        gap, held_out = result.gap, result.held_out_gap
        noise_floor = "" if gap.floor is None else f" (noise alone: {gap.floor:.3f})"
        words = describe_reduction(gap.before, gap.after, gap.floor)
        print_line(f"gap {gap.before:.3f} → {gap.after:.3f}{noise_floor}{'; ' + words if words else ''}")
        print_line(f"held out {held_out.before:.3f} → {held_out.after:.3f}; {result.held_out_kind}")
        if result.found:
            console.print(_detected_effects_table(result))
        for finding in result.found:
            print_line(f"{finding.effect}: {finding.where}")
            confidence = (
                f"{describe_confidence(finding.confidence)} ({format_probability(finding.confidence)})"
            )
            print_line(f"  {confidence}; {describe_runner_up(finding)}")
            if finding.inseparable_from:
                print_line(f"  not separable in this log from {', '.join(finding.inseparable_from)}")
        for residual in result.remaining:
            print_line(f"residual in {residual.channel}, {residual.where}: {residual.looks_like}")
        for explanation in self.explanations:
            print_line(explanation.summary)
            if explanation.rows:
                console.print(_explain_table(explanation))
        for line in result.warnings:
            print_line(f"warning: {line}")
        if self.scaffold is not None:
            for line in self.scaffold.describe():
                print_line(line)
        elif self.scaffold_name is not None:
            print_line(
                f"--scaffold {self.scaffold_name}: the known effects explain the log; no new effect is needed"
            )
        print_line(", ".join(str(Path(self.output) / name) for name in GAP_FILES))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo gap`."""
    model = parser.add_argument(
        "model", type=Path, metavar="MODEL", help="model file (TOML): vehicle, noise, inputs"
    )
    log = parser.add_argument("log", type=Path, metavar="LOG", help=LOG_HELP)
    parser.add_argument(
        "--vehicle",
        type=Path,
        action=ReplacePositional,
        replaces=(log, model),
        metavar="TOML",
        help="[vehicle] and [nodes.*] instead of MODEL; noise and inputs of the model are estimated from LOG",
    )
    for option, words in (("--before", "earlier"), ("--after", "later")):
        parser.add_argument(
            option,
            type=Path,
            action=ReplacePositional,
            replaces=(log, model) if option == "--before" else (),
            metavar="LOG",
            help=f"instead of LOG: the {words} of two logs of one vehicle, to find out what has changed",
        )
    add_log_options(parser)
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="OUT", help=f"folder for {', '.join(GAP_FILES)}"
    )
    for option, words in (
        ("--accept", "add this effect to the model before the search; repeatable"),
        ("--reject", f"do not consider this effect; {EMPIRICAL} excludes empirical terms; repeatable"),
        ("--explain", "explain why this effect was not chosen; repeatable"),
    ):
        parser.add_argument(option, action="append", default=[], metavar="NAME", help=words)
    parser.add_argument(
        "--scaffold",
        metavar="NAME",
        help="write OUT/NAME.py, a new effect of this name for a dependence that no known effect explains",
    )
    add_effects_option(parser)
    parser.add_argument(
        "--resume",
        action="store_true",
        help="continue the interrupted search in OUT; log, model and options must be the same",
    )
    add_force_option(parser)


def run(args: argparse.Namespace) -> GapReport | ChangeReport:
    """Search for missing effects and write the three result files; or compare two logs.

    Returns
    -------
    GapReport or ChangeReport
        The gap and the detected effects, or the changes between two logs.

    Raises
    ------
    InputError
        If options contradict each other, an effect does not exist, or OUT holds other files.
    KeyboardInterrupt
        If the search was interrupted; the intermediate result is written first.
    """
    register_effects(args)
    check_argument_order(args)
    if args.before is not None or args.after is not None:
        return compare_logs(args)
    objection = "" if args.scaffold is None else name_problem(args.scaffold)
    if objection:
        raise InputError(f"--scaffold {args.scaffold}: {objection}")
    for option in ("accept", "reject", "explain"):
        _check_effect_names(option, getattr(args, option))
    contradictions = sorted(set(args.accept) & set(args.reject))
    if contradictions:
        raise InputError(f"--accept and --reject both name {contradictions[0]}; choose one")
    if args.vehicle is not None:
        if args.log is not None:
            raise InputError(
                f"{args.model} and --vehicle {args.vehicle}: both describe the vehicle; give one"
            )
        args.model, args.log = args.vehicle, args.model
    check_gap_folder(args.output, args.model, replace=args.force or args.resume)
    with progress_line() as show:
        problem, journal = _read_problem(args, show)
        result = find_problem_gap(
            problem, accept=args.accept, reject=args.reject, report_progress=show, journal=journal
        )
        new_effect = None
        if args.scaffold is not None and result.is_finished:
            show(f"searching a dependence for {args.scaffold}", 0.95)
            new_effect = build_scaffold(result.search, args.scaffold, args.log)
        show("writing the report", 0.97)
        contents = gap_file_contents(result, log=args.log.name, model=args.model.name)
    if new_effect is not None:
        contents[f"{new_effect.name}.py"] = new_effect.source
    write_files(args.output, contents)
    if not result.is_finished:
        # The user pressed ctrl-C: exit as interrupted, now that the intermediate result is written.
        raise KeyboardInterrupt(f"{args.output} holds the intermediate result; --resume continues")
    journal.delete()
    return GapReport(
        result,
        str(args.output),
        tuple(explain_effect(result, name, name in args.reject) for name in dict.fromkeys(args.explain)),
        new_effect,
        args.scaffold,
    )


def _read_problem(args: argparse.Namespace, show: ReportProgress) -> tuple[Problem, Journal]:
    """Return the estimation problem posed by log and model, and the journal of the search.

    The log is large; it is released when this function returns.
    """
    model = None if args.vehicle is not None else read_model(args.model)
    vehicle = load_vehicle(args.vehicle) if model is None else model.vehicle
    inputs = () if model is None else (model.inputs.speed, model.inputs.yaw_rate)
    needed = (NODES_ROLE, *("reference" for name in inputs if str(name).startswith("reference.")))
    recording = read_log(args.log, input_format=log_form(args, vehicle, needed=needed), progress=show)
    check_node_names(vehicle, recording, str(args.vehicle or args.model))
    model = model or assume_model(recording, vehicle, str(args.log))
    journal = _journal(args, recording, model)
    return build_problem(recording, model, str(args.log)), journal


def _journal(args: argparse.Namespace, recording: Recording, model: Model) -> Journal:
    """Return the journal of the search, which is kept in the output folder until the search is finished."""
    sources = [path.read_text("utf-8") for path in args.effects]
    key = compute_fingerprint(
        recording, model, __version__, sorted(args.accept), sorted(args.reject), sources
    )
    return Journal(args.output / JOURNAL_FILE, key, args.resume)


def _check_effect_names(option: str, names: Iterable[str]) -> None:
    known = (*BY_NAME, EMPIRICAL) if option == "reject" else tuple(BY_NAME)
    for name in names:
        if name not in known:
            hint = suggest_spelling(name, known) or f"; they are {', '.join(known)}"
            raise InputError(f"--{option} {name}: no such effect{hint}")


def _detected_effects_table(result: GapResult) -> TextTable:
    table = TextTable("effect", "scope", "parameters", "confidence", "gap", "held out")
    for finding in result.found:
        values = "\n".join(format_parameter(name, one) for name, one in finding.parameters.items())
        table.add_row(
            finding.effect,
            finding.scope,
            values,
            format_probability(finding.confidence),
            f"{finding.gap.before:.3f} → {finding.gap.after:.3f}",
            f"{finding.held_out_gap.before:.3f} → {finding.held_out_gap.after:.3f}",
        )
    return table


def _explain_table(explanation: Explanation) -> TextTable:
    table = TextTable(
        "round",
        "scope",
        "gain",
        "ln Bayes factor",
        "probability in the round",
        "beaten by",
        title=explanation.effect,
    )
    for row in explanation.rows:
        share = "not refitted" if row.probability is None else format_probability(row.probability)
        table.add_row(
            str(row.round), row.scope, f"{row.gain:.1f}", f"{row.evidence:.1f}", share, row.beaten_by
        )
    return table
