"""`hubodo gap`: find the effects that a model lacks to explain a log."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from hubodo.effects import BY_NAME
from hubodo.effects.loaded import name_problem
from hubodo.errors import InputError
from hubodo.gap.explain.explanation import explain_effect
from hubodo.gap.explain.files import check_gap_folder, gap_file_contents, write_files
from hubodo.gap.explain.missing_effects import MissingEffects
from hubodo.gap.explain.terminal import GAP_FILES
from hubodo.gap.judge.journal import Journal, compute_fingerprint
from hubodo.gap.judge.round import EMPIRICAL, ReportProgress
from hubodo.gap.problem.assumed import assume_model
from hubodo.gap.problem.build import build_problem
from hubodo.gap.problem.problem import Problem
from hubodo.gap.scaffold.scaffold import build_scaffold
from hubodo.gap.workflow import find_problem_gap
from hubodo.log.any_log import read_log
from hubodo.log.roles import NODES_ROLE
from hubodo.model.model_file import Model, read_model
from hubodo.progress import progress_line
from hubodo.recording import Recording
from hubodo.spelling import suggest_spelling
from hubodo.vehicle import load_vehicle
from hubodo.verbs.effect_options import add_effects_option, register_effects
from hubodo.verbs.gap_arguments import check_argument_order
from hubodo.verbs.gap_change import ChangeReport, ReplacePositional, compare_logs
from hubodo.verbs.log_options import LOG_HELP, add_log_options, check_node_names, stated_input_format
from hubodo.verbs.outputs import add_force_option
from hubodo.version import __version__

EXAMPLE = "hubodo gap model.toml drive.mcap -o gap/"
JOURNAL_FILE = "unfinished.jsonl"


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


def run(args: argparse.Namespace) -> MissingEffects | ChangeReport:
    """Search for missing effects and write the three result files; or compare two logs.

    Returns
    -------
    MissingEffects or ChangeReport
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
        result = replace(result, log=args.log.name, given=args.model.name, output=str(args.output))
        contents = gap_file_contents(result)
    if new_effect is not None:
        contents[f"{new_effect.name}.py"] = new_effect.source
    write_files(args.output, contents)
    if not result.is_finished:
        # The user pressed ctrl-C: exit as interrupted, now that the intermediate result is written.
        raise KeyboardInterrupt(f"{args.output} holds the intermediate result; --resume continues")
    journal.delete()
    explained = (explain_effect(result, name, name in args.reject) for name in dict.fromkeys(args.explain))
    return replace(result, explanations=tuple(explained), scaffold=new_effect, scaffold_name=args.scaffold)


def _read_problem(args: argparse.Namespace, show: ReportProgress) -> tuple[Problem, Journal]:
    """Return the estimation problem posed by log and model, and the journal of the search.

    The log is large; it is released when this function returns.
    """
    model = None if args.vehicle is not None else read_model(args.model)
    vehicle = load_vehicle(args.vehicle) if model is None else model.vehicle
    inputs = () if model is None else (model.inputs.speed, model.inputs.yaw_rate)
    needed = (NODES_ROLE, *("reference" for name in inputs if str(name).startswith("reference.")))
    recording = read_log(
        args.log, input_format=stated_input_format(args, vehicle, needed=needed), progress=show
    )
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
