"""`hubodo gap --before LOG --after LOG`: what has changed on a vehicle between two logs."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table as TextTable

from hubodo.atomic_files import atomic_files
from hubodo.effects import BY_NAME
from hubodo.errors import InputError
from hubodo.gap.change.change import Change, ChangeResult, find_change
from hubodo.gap.problem.assumed import assumed_model
from hubodo.gap.state.terms import ALL, VEHICLE
from hubodo.gap.tell.account import probability, with_sigma
from hubodo.log.any_log import read_log
from hubodo.log.roles import NODES_ROLE
from hubodo.model.model_file import model_toml, read_model
from hubodo.progress import progress_line
from hubodo.safe_text import json_text
from hubodo.vehicle import load_vehicle
from hubodo.verbs.log_options import log_form

CHANGE_FILES = ("change.json", "before.toml", "after.toml")
# What differs from drive to drive on a vehicle that nobody touched, and why.
_OF_THE_DRIVE = {
    "road_grade": "another road would do that",
    "gyro_bias": "a gyro's offset differs from start to start",
    "gyro_warmup": "a warm start and a cold one differ so",
    "gyro_rate_random_walk": "a gyro wanders from start to start",
    "time_offset": "clocks may differ from start to start",
}


@dataclass(frozen=True)
class ChangeReport:
    """What two logs say of a vehicle, and where it was written."""

    result: ChangeResult
    output: str

    def as_json(self) -> dict[str, Any]:
        """`change.json`."""
        return self.result.as_json()

    def render(self, console: Console) -> None:
        """The verdict, then a row for each change."""
        result = self.result

        def say(text: str) -> None:
            console.print(text, highlight=False, markup=False, soft_wrap=True)

        say(verdict(result))
        if result.changes:
            table = TextTable("effect", "of", "before", "after", "change", "chance")
            for it in result.changes:
                columns = zip(*(_texts(it, name) for name in it.values), strict=True)
                table.add_row(
                    it.effect, it.scope, *("\n".join(lines) for lines in columns), probability(it.p_value)
                )
            console.print(table)
        for it in result.changes:
            say(f"{it.effect}: {it.where}")
            if it.effect in _OF_THE_DRIVE:
                say(f"  {_OF_THE_DRIVE[it.effect]}: not necessarily the vehicle")
        for name in result.unnamed:
            say(f"also different, without a name: {name}")
        for line in result.warnings:
            say(f"warning: {line}")
        say(", ".join(str(Path(self.output) / name) for name in CHANGE_FILES))


def verdict(result: ChangeResult) -> str:
    """In one sentence."""
    chance = f"if nothing has, logs differ as much in {probability(result.p_value)} of all pairs"
    if not result.changed:
        return f"Nothing has changed that these logs could show ({chance})."
    if not result.changes:
        return f"Something has changed, and no known effect says what ({chance})."
    words = [_meaning(it) for it in result.changes]
    return f"Changed: {'; '.join(words)} ({chance})."


def _meaning(it: Change) -> str:
    place = {ALL: " (all nodes)", VEHICLE: ""}.get(it.scope, f" ({it.scope})")
    return f"{BY_NAME[it.effect].meaning}{place}"


def _texts(it: Change, name: str) -> tuple[str, str, str]:
    before, after, change = (f"{with_sigma(value.value, value.sigma)}" for value in it.values[name])
    unit = it.values[name][0].unit
    return f"{name} {before}", after, f"{change} {'' if unit == '1' else unit}".rstrip()


class InsteadOf(argparse.Action):
    """An option with which one argument by place less is needed, the last first."""

    def __init__(self, *, replaces: Sequence[argparse.Action], **words: Any) -> None:
        super().__init__(**words)
        self.replaces = replaces

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, option: Any = None
    ) -> None:
        setattr(namespace, self.dest, values)
        needed = [argument for argument in self.replaces if argument.required]
        for argument in needed[:1]:
            argument.required = False


def compare_logs(args: argparse.Namespace) -> ChangeReport:
    """Read both, compare, write three files."""
    if args.before is None or args.after is None:
        raise InputError("--before and --after go together: name two logs of one vehicle")
    for option in ("accept", "reject", "explain", "scaffold", "resume"):
        if getattr(args, option):
            raise InputError(f"--{option} goes with one log, not with --before and --after")
    if args.log is not None or (args.model is not None and args.vehicle is not None):
        raise InputError("--before and --after go with MODEL or --vehicle and no other log")
    if args.model is None and args.vehicle is None:
        raise InputError("name the vehicle: MODEL, or --vehicle TOML")
    there = args.output / "before.toml"
    if there.exists() and not (args.output / "change.json").exists():
        raise InputError(f"{there}: exists and is no result of gap; name another folder with -o")
    model = None if args.model is None else read_model(args.model)
    vehicle = load_vehicle(args.vehicle) if model is None else model.vehicle
    with progress_line() as show:
        form = log_form(args, vehicle, needed=(NODES_ROLE,))
        logs = [read_log(path, input_format=form, progress=show) for path in (args.before, args.after)]
        # The noise of both is that of the first: a sensor that has become noisy is not to hide in it.
        model = model or assumed_model(logs[0], vehicle, str(args.before))
        result = find_change(logs[0], logs[1], model, where=(str(args.before), str(args.after)), say=show)
    text = json_text(result.as_json(), indent=1, ascii_only=False)
    models = (model_toml(result.before), model_toml(result.after))
    with atomic_files(*(args.output / name for name in CHANGE_FILES), create_folder=True) as parts:
        for part, content in zip(parts, (f"{text}\n", *models), strict=True):
            part.write_text(content, "utf-8", "backslashreplace")
    return ChangeReport(result, str(args.output))
