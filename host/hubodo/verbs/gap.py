"""`hubodo gap`: what a model lacks to explain a log, and the model with it added."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table as TextTable

from hubodo.effects import BY_NAME
from hubodo.effects.loaded import free_name
from hubodo.errors import InputError
from hubodo.gap.judge.journal import Journal, fingerprint
from hubodo.gap.judge.round import EMPIRICAL, Say
from hubodo.gap.problem.assumed import assumed_model
from hubodo.gap.problem.build import build
from hubodo.gap.problem.problem import Problem
from hubodo.gap.scaffold.scaffold import Scaffold, scaffold
from hubodo.gap.tell.account import (
    probability,
    runner_up_words,
    shrunk,
    sure,
    verdict,
    what_to_do,
    with_sigma,
)
from hubodo.gap.tell.explain import Explanation, explain
from hubodo.gap.tell.result import GapResult
from hubodo.gap.workflow import find_gap_in
from hubodo.log.any_log import read_log
from hubodo.log.roles import NODES_ROLE
from hubodo.model.model_file import Model, read_model
from hubodo.progress import progress_line
from hubodo.recording import Recording
from hubodo.report.gap_files import FILES, check_gap_folder, gap_contents, gap_json, plain, write_texts
from hubodo.toml_file import suggest_spelling
from hubodo.vehicle import load_vehicle
from hubodo.verbs.effect_options import add_effects_option, know_effects
from hubodo.verbs.gap_change import ChangeReport, InsteadOf, compare_logs
from hubodo.verbs.log_options import LOG_HELP, add_log_options, log_form
from hubodo.version import __version__

EXAMPLE = "hubodo gap model.toml drive.mcap -o gap/"
UNFINISHED = "unfinished.jsonl"


@dataclass(frozen=True)
class GapReport:
    """What was found, where it was written, and why some effects were not chosen."""

    result: GapResult
    output: str
    explained: tuple[Explanation, ...]
    scaffold: Scaffold | None = None
    wanted: str | None = None

    @property
    def failed(self) -> bool:
        """Whether an effect was to be made and nothing asked for one."""
        return self.wanted is not None and self.scaffold is None

    def as_json(self) -> dict[str, Any]:
        """`gap.json`, with what --explain asked for."""
        made = gap_json(self.result)
        if self.explained:
            made["explain"] = plain([it.as_json() for it in self.explained])
        if self.scaffold is not None:
            made["scaffold"] = plain(self.scaffold.as_json())
        return made

    def render(self, console: Console) -> None:
        """The verdict, the gap, what was found, what remains, what to do."""
        result = self.result

        def say(text: str) -> None:
            console.print(text, highlight=False, markup=False, soft_wrap=True)

        say(verdict(result))
        whole, outside = result.gap, result.held_out_gap
        least = "" if whole.floor is None else f" (noise alone: {whole.floor:.3f})"
        words = shrunk(whole.before, whole.after, whole.floor)
        say(f"gap {whole.before:.3f} → {whole.after:.3f}{least}{'; ' + words if words else ''}")
        say(f"held out {outside.before:.3f} → {outside.after:.3f}; {result.held_out}")
        if result.found:
            console.print(_found_table(result))
        for finding in result.found:
            say(f"{finding.effect}: {finding.where}")
            how_sure = f"{sure(finding.confidence)} ({probability(finding.confidence)})"
            say(f"  {how_sure}; {runner_up_words(finding)}")
            if finding.inseparable_from:
                say(f"  this log cannot tell it from {', '.join(finding.inseparable_from)}")
        for left in result.remaining:
            say(f"left in {left.channel}, {left.where}: {left.looks_like}")
        for line in what_to_do(result):
            say(f"→ {line}")
        for it in self.explained:
            say(it.summary)
            if it.rows:
                console.print(_explain_table(it))
        for line in result.warnings:
            say(f"warning: {line}")
        if self.scaffold is not None:
            for line in self.scaffold.words():
                say(line)
        elif self.wanted is not None:
            say(f"--scaffold {self.wanted}: nothing is left that asks for an effect without a name")
        say(", ".join(str(Path(self.output) / name) for name in FILES))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `hubodo gap`."""
    model = parser.add_argument(
        "model", type=Path, metavar="MODEL", help="model file (TOML): vehicle, noise, inputs"
    )
    log = parser.add_argument("log", type=Path, metavar="LOG", help=LOG_HELP)
    parser.add_argument(
        "--vehicle",
        type=Path,
        action=InsteadOf,
        replaces=(log, model),
        metavar="TOML",
        help="[vehicle] and [nodes.*] instead of MODEL: the noise and what drives the model are as LOG shows",
    )
    for option, words in (("--before", "an earlier one"), ("--after", "a later one")):
        parser.add_argument(
            option,
            type=Path,
            action=InsteadOf,
            replaces=(log, model) if option == "--before" else (),
            metavar="LOG",
            help=f"instead of LOG: two of one vehicle, to be told what has changed; {words}",
        )
    add_log_options(parser)
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="OUT", help=f"folder for {', '.join(FILES)}"
    )
    for option, words in (
        ("--accept", "add this effect first, whatever else is found; again for more"),
        ("--reject", f"do not consider this effect, or {EMPIRICAL}: no term without a name; again for more"),
        ("--explain", "say why this effect was not chosen; again for more"),
    ):
        parser.add_argument(option, action="append", default=[], metavar="NAME", help=words)
    parser.add_argument(
        "--scaffold",
        metavar="NAME",
        help="write OUT/NAME.py: an effect of this name with the dependence that no known effect explains",
    )
    add_effects_option(parser)
    parser.add_argument(
        "--resume",
        action="store_true",
        help="go on with the search that was stopped in OUT; log, model and options have to be the same",
    )


def run(args: argparse.Namespace) -> GapReport | ChangeReport:
    """Read, search, write the three files; or compare two logs."""
    know_effects(args)
    if args.before is not None or args.after is not None:
        return compare_logs(args)
    says = "" if args.scaffold is None else free_name(args.scaffold)
    if says:
        raise InputError(f"--scaffold {args.scaffold}: {says}")
    for option in ("accept", "reject", "explain"):
        _known(option, getattr(args, option))
    both = sorted(set(args.accept) & set(args.reject))
    if both:
        raise InputError(f"--accept and --reject both name {both[0]}; choose one")
    if args.vehicle is not None:
        if args.log is not None:
            raise InputError(f"{args.model} and --vehicle {args.vehicle}: both say the vehicle; give one")
        args.model, args.log = args.vehicle, args.model
    check_gap_folder(args.output, args.model)
    with progress_line() as show:
        problem, journal = _posed(args, show)
        result = find_gap_in(problem, accept=args.accept, reject=args.reject, say=show, journal=journal)
        made = None
        if args.scaffold is not None and result.finished:
            show(f"looking for {args.scaffold}", 0.95)
            made = scaffold(result.search, args.scaffold, args.log)
        show("writing the report", 0.97)
        contents = gap_contents(result, log=args.log.name, model=args.model.name)
    if made is not None:
        contents[f"{made.name}.py"] = made.text
    write_texts(args.output, contents)
    if not result.finished:
        # As whoever pressed ctrl-C expects, after the files are written.
        raise KeyboardInterrupt(f"{args.output} has what was found until then; --resume goes on")
    journal.forget()
    return GapReport(
        result,
        str(args.output),
        tuple(explain(result, name, name in args.reject) for name in dict.fromkeys(args.explain)),
        made,
        args.scaffold,
    )


def _posed(args: argparse.Namespace, show: Say) -> tuple[Problem, Journal]:
    """What the log and the model file, or what the log says in its place, ask; and where rounds are kept.

    The log itself is large, and no longer needed then.
    """
    model = None if args.vehicle is not None else read_model(args.model)
    vehicle = load_vehicle(args.vehicle) if model is None else model.vehicle
    driven_by = () if model is None else (model.inputs.speed, model.inputs.yaw_rate)
    needed = (NODES_ROLE, *("reference" for name in driven_by if str(name).startswith("reference.")))
    recording = read_log(args.log, input_format=log_form(args, vehicle, needed=needed), progress=show)
    model = model or assumed_model(recording, vehicle, str(args.log))
    journal = _journal(args, recording, model)
    return build(recording, model, str(args.log)), journal


def _journal(args: argparse.Namespace, recording: Recording, model: Model) -> Journal:
    """The rounds of the search, kept in the folder until it is finished."""
    sources = [path.read_text("utf-8") for path in args.effects]
    what = fingerprint(recording, model, __version__, sorted(args.accept), sorted(args.reject), sources)
    return Journal(args.output / UNFINISHED, what, args.resume)


def _known(option: str, names: Iterable[str]) -> None:
    known = (*BY_NAME, EMPIRICAL) if option == "reject" else tuple(BY_NAME)
    for name in names:
        if name not in known:
            hint = suggest_spelling(name, known) or f"; they are {', '.join(known)}"
            raise InputError(f"--{option} {name}: no such effect{hint}")


def _found_table(result: GapResult) -> TextTable:
    table = TextTable("effect", "of", "parameters", "confidence", "gap", "held out")
    for finding in result.found:
        values = "\n".join(
            f"{name} {with_sigma(it.value, it.sigma)} {'' if it.unit == '1' else it.unit}".rstrip()
            for name, it in finding.parameters.items()
        )
        table.add_row(
            finding.effect,
            finding.scope,
            values,
            probability(finding.confidence),
            f"{finding.gap.before:.3f} → {finding.gap.after:.3f}",
            f"{finding.held_out_gap.before:.3f} → {finding.held_out_gap.after:.3f}",
        )
    return table


def _explain_table(it: Explanation) -> TextTable:
    table = TextTable("round", "of", "gain", "ln Bayes factor", "probability", "beaten by", title=it.effect)
    for row in it.rows:
        share = "not refitted" if row.probability is None else probability(row.probability)
        table.add_row(
            str(row.round), row.scope, f"{row.gain:.1f}", f"{row.evidence:.1f}", share, row.beaten_by
        )
    return table
