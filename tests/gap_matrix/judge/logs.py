"""Logs of cells: the files of a cell and its truth."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gap_matrix import alike, cases, outside, recording
from gap_matrix.cases import Setup
from gap_matrix.dose import GainMeter
from gap_matrix.effects import SIDES, Effect, scale_effect
from gap_matrix.judge.cells import Cell
from gap_matrix.sensor import Record

PERMUTATION_BLOCK_S = 5.0  # s


def write_log(cell: Cell, folder: Path) -> dict[str, Any]:
    """Write the files of a cell and return its truth, with its first seed whose drive shows the effect.

    Raises ValueError if the drive of no seed shows the effect.
    """
    reason = ""
    for seed in cell.seeds:
        try:
            return _write_log_of_seed(cell, seed, folder)
        except ValueError as error:
            reason = str(error)
    raise ValueError(reason)


def _write_log_of_seed(cell: Cell, seed: int, folder: Path) -> dict[str, Any]:
    """Write the files of a cell with one seed and return its truth."""
    if cell.table == "alike":
        return _write_confusable_log(cell, seed, folder)
    setup = cases.draw_setup(seed, **cell.options)
    if cell.table == "open":
        outside_effect = outside.hide_effect(setup, cell.name, cell.variant)
        truth = _describe_truth(setup, [], [outside_effect.gain])
        truth["outside"] = {
            "name": outside_effect.name,
            "node": outside_effect.node,
            "size": outside_effect.size,
            "channels": list(outside_effect.channels),
            "words": list(outside_effect.expected_words),
        }
        recording.write_case_files(setup, [], folder, truth, outside.simulate_records(setup, outside_effect))
        return truth
    meter = GainMeter(setup) if cell.hidden else None
    scaled_effects = [
        _scale_effect(meter, cases.draw_hidden_effect(setup, name), nats, cell.factor)
        for name, nats in cell.hidden
        if meter is not None
    ]
    hidden = [effect for effect, _ in scaled_effects]
    truth = _describe_truth(setup, hidden, [gain for _, gain in scaled_effects])
    records = None
    if cell.variant == "permuted temperature":
        records = permute_temperature(
            setup, {node: cases.simulate_node_record(setup, node, hidden) for node in SIDES}
        )
    recording.write_case_files(setup, hidden, folder, truth, records)
    if cell.table == "controls" and cell.hidden:
        records = permute_temperature(
            setup, {node: cases.simulate_node_record(setup, node, hidden) for node in SIDES}
        )
        recording.write_case_files(setup, hidden, folder / "permuted", truth, records)
    return truth


def _scale_effect(
    meter: GainMeter, effect: Effect, nats: float, factor: float | None
) -> tuple[Effect, float]:
    """Return the effect scaled to a gain or by a factor, and its gain in nats."""
    if factor is None:
        return meter.scale_to_gain(effect, nats)
    scaled = scale_effect(effect, factor)
    return scaled, meter.gain(scaled)


def _write_confusable_log(cell: Cell, seed: int, folder: Path) -> dict[str, Any]:
    """Write a log with one effect of a confusable pair and return its truth."""
    pair = next(pair for pair in alike.CONFUSABLE_PAIRS if pair.name == cell.name)
    name, nats = cell.hidden[0]
    is_ambiguous = cell.variant == "blunt"
    setup = (
        alike.draw_ambiguous_setup(seed, pair)
        if is_ambiguous
        else cases.draw_setup(seed, duration=alike.DURATION_S)
    )
    effect = pair.first if pair.first.name == name else pair.second
    other = pair.second if effect is pair.first else pair.first
    if not is_ambiguous:
        # Drawn at random: two effects with the parameters of the pair resemble a third effect on any drive.
        effect = cases.draw_hidden_effect(setup, name, effect.scope)
    dead_sensor = pair.dead_sensor if is_ambiguous else ""
    effect, gain = GainMeter(setup, dead_sensor=dead_sensor).scale_to_gain(effect, nats)
    truth = _describe_truth(setup, [effect], [gain])
    truth["other"] = other.name
    truth["why"] = pair.reason if is_ambiguous else ""
    recording.write_case_files(
        setup, [effect], folder, truth, alike.simulate_records(setup, [effect], dead_sensor)
    )
    return truth


def permute_temperature(setup: Setup, records: Mapping[str, Record]) -> dict[str, Record]:
    """Return the records of all nodes with the blocks of their temperature permuted."""
    rng = np.random.default_rng((setup.seed, 10))
    permuted_records = {}
    for node, record in records.items():
        blocks = np.array_split(record.temperature, max(2, round(np.ptp(record.t) / PERMUTATION_BLOCK_S)))
        shuffled = np.concatenate([blocks[k] for k in rng.permutation(len(blocks))])
        permuted_records[node] = Record(record.t, record.values, shuffled)
    return permuted_records


def _describe_truth(setup: Setup, hidden: list[Effect], gains: list[float]) -> dict[str, Any]:
    """Return the truth of a log: hidden effects, their gains, and the drive."""
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
