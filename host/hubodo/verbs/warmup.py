"""`hubodo warmup`: model the bias of a gyro after power-on."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from hubodo.atomic_files import write_atomically
from hubodo.calibration.file import (
    CalibratedEffect,
    Calibration,
    NodeCalibration,
    Quantity,
    hash_source,
    read_calibration,
    write_calibration,
)
from hubodo.errors import InputError
from hubodo.pages.drawing import save_figure
from hubodo.pages.page import render_page
from hubodo.sensors.standstill_channel import IMU_CHANNELS, StandstillRecord
from hubodo.sensors.warmup.characterise import characterise_standstill_warmup
from hubodo.sensors.warmup.figure import warmup_figure
from hubodo.sensors.warmup.page import summarise_warmup, warmup_sections
from hubodo.sensors.warmup.result import WarmupResult
from hubodo.verbs.numbers import non_negative_number
from hubodo.verbs.standstill import add_page_options, add_standstill_arguments, read_standstill

EXAMPLE = "hubodo warmup cold_start.mcap --node left --channel gz -o calibration.toml"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo warmup`."""
    add_standstill_arguments(parser, IMU_CHANNELS[:3])
    parser.add_argument(
        "--age",
        type=non_negative_number,
        default=0.0,
        help="time since power-on at the first sample, s (default 0)",
    )
    parser.add_argument(
        "-o", "--output", type=Path, metavar="TOML", help="calibration file to create or extend by this axis"
    )
    parser.add_argument(
        "--form",
        choices=("exponential", "two exponentials"),
        help="stated form of the warm-up, which is believed (default: the forecast averages all forms)",
    )
    parser.add_argument(
        "--at",
        type=non_negative_number,
        action="append",
        default=[],
        metavar="AGE",
        help="time since power-on to forecast the bias for, s; repeatable (default: several)",
    )
    add_page_options(parser, "write record, models and forecast as .png, .svg or .pdf")


def run(args: argparse.Namespace) -> WarmupResult:
    """Fit the warm-up models; extend the calibration file and write page and figure where asked.

    Returns
    -------
    WarmupResult
        Models, whiteness tests and forecasts.

    Raises
    ------
    InputError
        If the sensor moved, the record does not suffice, or no model is accepted for the calibration file.
    """
    standstill = read_standstill(args)
    result = replace(
        characterise_standstill_warmup(standstill, age=args.age, form=args.form),
        ages=tuple(args.at),
        log=str(args.log),
        output=None if args.output is None else str(args.output),
    )
    if args.output is not None:
        try:
            extend_calibration(args.output, result, standstill, hash_source(args.log))
        except InputError as error:
            raise InputError(f"{standstill.source}: {error}") from None
    title = f"Warm-up of {result.name}"
    if args.report is not None:
        write_atomically(args.report, render_page(title, summarise_warmup(result), warmup_sections(result)))
    if args.figure is not None:
        save_figure(warmup_figure(result, title), args.figure)
    return result


def extend_calibration(
    path: Path, result: WarmupResult, standstill: StandstillRecord, source_sha256: str
) -> None:
    """Add the accepted model to a calibration file, which is created if it does not exist."""
    before = read_calibration(path) if path.exists() else Calibration()
    node = before.nodes.get(result.node, NodeCalibration())
    temperature, date = standstill.temperature, datetime.now(UTC).date().isoformat()
    span = None if temperature is None else (float(temperature.min()), float(temperature.max()))
    effects = {
        name: merge_effects(
            node.effects.get(name), replace(e, date=date, source_sha256=source_sha256, temperature=span)
        )
        for name, e in result.calibrated_effects().items()
    }
    calibration = before.with_node(result.node, effects, standstill.serial)
    write_calibration(_remove_superseded(calibration, result.node, effects, result.channel[1]), path)


def _remove_superseded(
    calibration: Calibration, node: str, effects: Mapping[str, CalibratedEffect], axis: str
) -> Calibration:
    """Remove warm-up parameters of this axis that an earlier model had and the accepted one does not have."""
    remaining = dict(calibration.nodes[node].effects)
    for name in {"gyro_warmup", "gyro_temperature"} & (remaining.keys() - effects.keys()):
        other_axes = {key: q for key, q in remaining[name].parameters.items() if key[:1] != axis}
        if _axes(other_axes):
            remaining[name] = replace(remaining[name], parameters=other_axes)
        else:
            del remaining[name]
    changed = replace(calibration.nodes[node], effects=remaining)
    return replace(calibration, nodes={**calibration.nodes, node: changed})


def merge_effects(old: CalibratedEffect | None, new: CalibratedEffect) -> CalibratedEffect:
    """Merge the parameters of a new axis into those of the other axes.

    A shared time constant becomes the mean, weighted by inverse variance. Raises InputError if the time
    constants differ by more than 4σ, as one number cannot represent both.
    """
    if old is None:
        return new
    existing = {name: q for name, q in old.parameters.items() if name[:1] not in _axes(new.parameters)}
    parameters = {**existing, **new.parameters}
    axes = _axes(existing)
    for name in ("time_constant", "time_constant_second"):
        if not axes or name not in existing or name not in new.parameters:
            continue
        before, after = existing[name], new.parameters[name]
        if abs(before.value - after.value) > 4.0 * math.hypot(before.sigma, after.sigma):
            raise InputError(
                f"the {name} {after.value:.4g} s differs from {before.value:.4g} s of axis "
                f"{', '.join(sorted(axes))} in the "
                "calibration file, where all axes share one; write the axes to separate files"
            )
        weights = before.sigma**-2, after.sigma**-2
        mean = (weights[0] * before.value + weights[1] * after.value) / sum(weights)
        parameters[name] = Quantity(mean, sum(weights) ** -0.5)
    if not any(name.endswith("_second") and name[:1] in "xyz" for name in parameters):
        parameters.pop("time_constant_second", None)
    return replace(new, parameters=parameters)


def _axes(parameters: Iterable[str]) -> set[str]:
    return {name[:1] for name in parameters if name[:1] in "xyz"}
