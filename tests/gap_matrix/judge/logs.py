"""Logs of cells: writes the files of a cell and returns its truth."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gap_matrix import alike, cases, outside, recording
from gap_matrix.cases import Setup
from gap_matrix.dose import Meter
from gap_matrix.effects import SIDES, Effect, scaled
from gap_matrix.judge.cells import Cell
from gap_matrix.sensor import Record

BLOCK = 5.0  # s


def make(cell: Cell, folder: Path) -> dict[str, Any]:
    """Write the folder of a cell and return its truth; uses the first seed in which the effect is visible.

    ValueError when none of the cell's seeds can.
    """
    reason = ""
    for seed in cell.seeds:
        try:
            return _make(cell, seed, folder)
        except ValueError as error:
            reason = str(error)
    raise ValueError(reason)


def _make(cell: Cell, seed: int, folder: Path) -> dict[str, Any]:
    if cell.table == "alike":
        return _look_alike(cell, seed, folder)
    setup = cases.setup(seed, **cell.options)
    if cell.table == "open":
        outsider = outside.hide(setup, cell.name, cell.variant)
        truth = _truth(setup, [], [outsider.gain])
        truth["outside"] = {
            "name": outsider.name,
            "node": outsider.node,
            "size": outsider.size,
            "channels": list(outsider.channels),
            "words": list(outsider.words),
        }
        recording.write(setup, [], folder, truth, outside.records(setup, outsider))
        return truth
    meter = Meter(setup) if cell.hidden else None
    dosed = [
        _dosed(meter, cases.hidden_effect(setup, name), nats, cell.factor)
        for name, nats in cell.hidden
        if meter is not None
    ]
    hidden = [effect for effect, _ in dosed]
    truth = _truth(setup, hidden, [gain for _, gain in dosed])
    records = None
    if cell.variant == "permuted temperature":
        records = permuted(setup, {node: cases.record(setup, node, hidden) for node in SIDES})
    recording.write(setup, hidden, folder, truth, records)
    if cell.table == "controls" and cell.hidden:
        records = permuted(setup, {node: cases.record(setup, node, hidden) for node in SIDES})
        recording.write(setup, hidden, folder / "permuted", truth, records)
    return truth


def _dosed(meter: Meter, effect: Effect, nats: float, factor: float | None) -> tuple[Effect, float]:
    if factor is None:
        return meter.dose(effect, nats)
    made = scaled(effect, factor)
    return made, meter.gain(made)


def _look_alike(cell: Cell, seed: int, folder: Path) -> dict[str, Any]:
    pair = next(pair for pair in alike.PAIRS if pair.name == cell.name)
    name, nats = cell.hidden[0]
    is_blunt = cell.variant == "blunt"
    setup = alike.blunt(seed, pair) if is_blunt else cases.setup(seed, duration=alike.SECONDS)
    effect = pair.one if pair.one.name == name else pair.other
    other = pair.other if effect is pair.one else pair.one
    if not is_blunt:
        # As it comes, not in the form that looks alike: two of these look like a third effect on any drive.
        effect = cases.hidden_effect(setup, name, effect.scope)
    dead = pair.dead if is_blunt else ""
    effect, gain = Meter(setup, dead=dead).dose(effect, nats)
    truth = _truth(setup, [effect], [gain])
    truth["other"] = other.name
    truth["why"] = pair.why if is_blunt else ""
    recording.write(setup, [effect], folder, truth, alike.records(setup, [effect], dead))
    return truth


def permuted(setup: Setup, records: Mapping[str, Record]) -> dict[str, Record]:
    """Return the temperature of each node with shuffled blocks of BLOCK seconds."""
    rng = np.random.default_rng((setup.seed, 10))
    made = {}
    for node, one in records.items():
        blocks = np.array_split(one.temperature, max(2, round(np.ptp(one.t) / BLOCK)))
        shuffled = np.concatenate([blocks[k] for k in rng.permutation(len(blocks))])
        made[node] = Record(one.t, one.values, shuffled)
    return made


def _truth(setup: Setup, hidden: list[Effect], gains: list[float]) -> dict[str, Any]:
    return {
        "seed": setup.seed,
        "effects": [
            {
                "name": effect.name,
                "scope": effect.scope,
                "parameters": {key: float(value) for key, value in effect.parameters.items()},
            }
            for effect in hidden
        ],
        "gain_nats": [float(gain) for gain in gains],
        "kind": setup.drive.kind,
        "duration": setup.drive.duration,
        "known": [effect.name for effect in setup.known],
    }
