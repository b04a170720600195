"""`hubodo gap --before LOG --after LOG`: find out what has changed on a vehicle between two logs."""

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
from hubodo.gap.change.change import find_change
from hubodo.gap.change.result import Change, ChangeResult
from hubodo.gap.explain.summary import format_angle, format_probability, format_with_sigma
from hubodo.gap.problem.assumed import assume_model
from hubodo.gap.state.terms import ALL, VEHICLE
from hubodo.log.any_log import read_log
from hubodo.log.roles import NODES_ROLE
from hubodo.model.model_file import read_model
from hubodo.model.model_text import model_toml
from hubodo.pages.console import print_text
from hubodo.progress import progress_line
from hubodo.safe_text import json_text
from hubodo.vehicle import load_vehicle
from hubodo.verbs.log_options import stated_input_format

CHANGE_FILES = ("change.json", "before.toml", "after.toml")
# Reasons why effects differ between drives of an unchanged vehicle; other such effects have the generic one.
_DRIVE_DEPENDENT_EFFECTS = {
    "road_grade": "another road has another grade",
    "road_bank": "another road has another bank",
    "gyro_bias": "the turn-on bias differs at each power-on",
    "gyro_warmup": "a warm start differs from a cold one",
    "gyro_rate_random_walk": "the bias random walk differs at each drive",
    "time_offset": "clock offsets may differ at each power-on",
}
_GENERIC_DRIVE_REASON = "it differs from drive to drive"


@dataclass(frozen=True)
class ChangeReport:
    """The changes between two logs of one vehicle, and the folder that they were written to."""

    result: ChangeResult
    output: str

    def as_json(self) -> dict[str, Any]:
        """Return the content of change.json."""
        return self.result.as_json()

    def render(self, console: Console) -> None:
        """Print the verdict, then one row for each change."""
        result = self.result

        print_text(console, change_verdict(result))
        if result.changes:
            table = TextTable("effect", "scope", "before", "after", "change", "p-value")
            for change in result.changes:
                columns = zip(*(_parameter_cells(change, name) for name in change.values), strict=True)
                table.add_row(
                    change.effect,
                    change.scope,
                    *("\n".join(lines) for lines in columns),
                    format_probability(change.p_value),
                )
            console.print(table)
        for change in result.changes:
            print_text(console, f"{change.effect} ({change.scope}): {change.where}")
            if change.belongs_to_drive:
                reason = _DRIVE_DEPENDENT_EFFECTS.get(change.effect, _GENERIC_DRIVE_REASON)
                print_text(console, f"  of the drive: {reason}, which is no change of the vehicle")
        for name in result.unnamed_terms:
            print_text(console, f"change that no known effect explains: {name}")
        for line in result.warnings:
            print_text(console, f"warning: {line}")
        print_text(console, ", ".join(str(Path(self.output) / name) for name in CHANGE_FILES))


def change_verdict(result: ChangeResult) -> str:
    """Return the verdict on the comparison in one sentence."""
    p_value = (
        f"an unchanged vehicle gives such a difference in {format_probability(result.p_value)} of all pairs"
    )
    if result.is_correlated:
        p_value = "judged on samples to which it was not fitted: the residuals are correlated"
    if not result.has_changed:
        of_drive = "; what differs is of the drives" if result.changes else ""
        return f"No significant change of the vehicle ({p_value}){of_drive}."
    if not result.vehicle_changes:
        return f"Something has changed that no known effect explains ({p_value})."
    meanings = [_effect_meaning(change) for change in result.vehicle_changes]
    return f"Changed: {'; '.join(meanings)} ({p_value})."


def _effect_meaning(change: Change) -> str:
    scope = {ALL: " (all nodes)", VEHICLE: ""}.get(change.scope, f" ({change.scope})")
    return f"{BY_NAME[change.effect].meaning}{scope}"


def _parameter_cells(change: Change, name: str) -> tuple[str, str, str]:
    before, after, difference = (
        f"{format_with_sigma(value.value, value.sigma)}" for value in change.values[name]
    )
    unit = change.values[name][0].unit
    angle = format_angle(change.values[name][2])
    parts = (difference, "" if unit == "1" else unit, f"({angle})" if angle else "")
    return f"{name} {before}", after, " ".join(part for part in parts if part)


class ReplacePositional(argparse.Action):
    """An option that makes one positional argument optional, the last one first."""

    def __init__(self, *, replaces: Sequence[argparse.Action], **settings: Any) -> None:
        super().__init__(**settings)
        self.replaces = replaces

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, option: Any = None
    ) -> None:
        setattr(namespace, self.dest, values)
        needed = [argument for argument in self.replaces if argument.required]
        for argument in needed[:1]:
            argument.required = False


def compare_logs(args: argparse.Namespace) -> ChangeReport:
    """Compare two logs of one vehicle and write change.json, before.toml and after.toml.

    Raises InputError if options contradict each other or the output folder holds other files.
    """
    if args.before is None or args.after is None:
        raise InputError("--before and --after go together: name two logs of one vehicle")
    for option in ("accept", "reject", "explain", "scaffold", "resume"):
        if getattr(args, option):
            raise InputError(f"--{option} goes with one log, not with --before and --after")
    if args.log is not None or (args.model is not None and args.vehicle is not None):
        raise InputError("--before and --after go with MODEL or --vehicle and no other log")
    if args.model is None and args.vehicle is None:
        raise InputError("name the vehicle: MODEL, or --vehicle TOML")
    earlier_result = args.output / "before.toml"
    if earlier_result.exists() and not (args.output / "change.json").exists():
        raise InputError(f"{earlier_result}: exists and is no result of gap; name another folder with -o")
    if earlier_result.exists() and not args.force:
        raise InputError(
            f"{earlier_result}: exists already; choose another name, or give --force to replace it"
        )
    model = None if args.model is None else read_model(args.model)
    vehicle = load_vehicle(args.vehicle) if model is None else model.vehicle
    with progress_line() as show:
        form = stated_input_format(args, vehicle, needed=(NODES_ROLE,))
        logs = [read_log(path, input_format=form, progress=show) for path in (args.before, args.after)]
        # Both logs use the noise of the first: otherwise a sensor that has become noisier would go unnoticed.
        model = model or assume_model(logs[0], vehicle, str(args.before))
        result = find_change(
            logs[0], logs[1], model, log_names=(str(args.before), str(args.after)), report_progress=show
        )
    text = json_text(result.as_json(), indent=1, ascii_only=False)
    models = (model_toml(result.model_before), model_toml(result.model_after))
    with atomic_files(*(args.output / name for name in CHANGE_FILES), create_folder=True) as parts:
        for part, content in zip(parts, (f"{text}\n", *models), strict=True):
            part.write_text(content, "utf-8", "backslashreplace")
    return ChangeReport(result, str(args.output))
