"""Cells of all tables: the hidden effects, the drive and the seed of each log."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import numpy as np

from gap_matrix import alike, effects, outside
from gap_matrix.dose import MEDIUM_NATS, STRENGTHS, STRONG_NATS

TABLES = ("singles", "nulls", "pairs", "open", "alike", "controls", "long")
SEED_RANGES = {"development": effects.DEVELOPMENT_SEEDS, "test": effects.TEST_SEEDS}
PAIR_LIST_SEED = 20
# Index of the first seed of each table within its thousand seeds. If a drive cannot show an effect, a spare
# seed is used.
_FIRST_SEED_INDEX = {
    "singles": 0,
    "nulls": 400,
    "pairs": 600,
    "open": 700,
    "alike": 800,
    "controls": 900,
    "long": 980,
}
_SPARE_SEEDS, _SPARE_SEED_STEP = 4, 37
CONTROL_EFFECTS = (
    "gyro_temperature", "gyro_g_sensitivity", "gyro_scale_factor", "node_misalignment",
    "lever_arm", "wheel_radius", "wheel_camber", "time_offset",
)  # fmt: skip


@dataclass(frozen=True)
class Cell:
    """One log to diagnose.

    name: effect, pair or kind
    variant: strength or kind of drive
    drive: number of the drive
    seeds: candidates; the first one whose drive shows the hidden effects is used
    hidden: names and gains in nats
    factor: multiple of the typical size, instead of nats
    options: further arguments of `cases.draw_setup`
    """

    table: str
    name: str
    variant: str
    drive: int
    seeds: tuple[int, ...]
    hidden: tuple[tuple[str, float], ...] = ()
    factor: float | None = None
    options: dict[str, Any] = field(default_factory=dict)

    @property
    def key(self) -> str:
        """Return the key of the cell in the file of results."""
        hidden = f", {self.hidden[0][0]} hidden" if self.table == "alike" else ""
        return f"{self.table}/{self.name}{hidden}/{self.variant}/{self.drive}/{self.seeds[0]}"


@dataclass(frozen=True)
class TableExtent:
    """The extent of the tables: which tables, and how many cells of each.

    names: only these effects, or kinds outside the vocabulary; default all
    """

    tables: Sequence[str] = TABLES
    seeds: str = "development"
    names: Sequence[str] = ()
    strengths: Sequence[str] = tuple(STRENGTHS)
    n_drives: int = 5
    n_nulls: int = 200
    n_pairs: int = 40


def list_cells(extent: TableExtent) -> list[Cell]:
    """Return all cells of the requested tables, in their order."""
    generators = {
        "singles": _singles,
        "nulls": _nulls,
        "pairs": _pairs,
        "open": _outside,
        "alike": _confusable,
        "controls": _controls,
        "long": _long,
    }
    return [cell for table in TABLES if table in extent.tables for cell in generators[table](extent)]


def _list_seeds(extent: TableExtent, table: str, number: int) -> tuple[int, ...]:
    """Return the seeds of a cell of a table: the first choice and the spares."""
    seed_range = SEED_RANGES[extent.seeds]
    return tuple(
        seed_range[(_FIRST_SEED_INDEX[table] + number + _SPARE_SEED_STEP * k) % len(seed_range)]
        for k in range(_SPARE_SEEDS)
    )


def _singles(extent: TableExtent) -> Iterator[Cell]:
    """Yield logs with one hidden effect; all strengths of an effect share the drives and the noise."""
    for k, name in enumerate(effects.KINDS):
        if extent.names and name not in extent.names:
            continue
        for strength in extent.strengths:
            for drive in range(extent.n_drives):
                seeds = _list_seeds(extent, "singles", 10 * k + drive)
                yield Cell("singles", name, strength, drive, seeds, ((name, STRENGTHS[strength]),))


def _nulls(extent: TableExtent) -> Iterator[Cell]:
    """Yield logs of one to four minutes without hidden effects.

    One in ten is a bench, one in ten a turntable; one in four has effects that the model file declares.
    """
    for k in range(extent.n_nulls):
        kind = {4: "bench", 9: "turntable"}.get(k % 10, "drive")
        known = ["lever_arm", "gyro_scale_factor"] if k % 4 == 2 else []
        variant = f"{kind}, declared effects" if known else kind
        yield Cell(
            "nulls",
            "nothing",
            variant,
            k,
            _list_seeds(extent, "nulls", k),
            options={"kind": kind, "known": known},
        )


def draw_pair_list(count: int) -> list[tuple[tuple[str, float], tuple[str, float]]]:
    """Return the first `count` pairs of a fixed random list, each name with a gain from medium to strong."""
    rng = np.random.default_rng(PAIR_LIST_SEED)
    all_pairs = list(combinations(effects.KINDS, 2))
    pairs = []
    for k in rng.permutation(len(all_pairs))[:count]:
        nats = np.exp(rng.uniform(np.log(MEDIUM_NATS), np.log(STRONG_NATS), 2)).round(0).tolist()
        first_name, second_name = all_pairs[k]
        pairs.append(((first_name, nats[0]), (second_name, nats[1])))
    return pairs


def _pairs(extent: TableExtent) -> Iterator[Cell]:
    """Yield logs with two hidden effects."""
    for k, hidden in enumerate(draw_pair_list(extent.n_pairs)):
        names = [name for name, _ in hidden]
        if not extent.names or set(names) & set(extent.names):
            yield Cell("pairs", " + ".join(names), "both", k, _list_seeds(extent, "pairs", k), hidden)


def _outside(extent: TableExtent) -> Iterator[Cell]:
    """Yield logs with an effect outside the vocabulary."""
    for k, name in enumerate(outside.KINDS):
        if extent.names and name not in extent.names:
            continue
        for strength in [strength for strength in extent.strengths if strength in outside.NATS]:
            for drive in range(extent.n_drives):
                yield Cell("open", name, strength, drive, _list_seeds(extent, "open", 10 * k + drive))


def _confusable(extent: TableExtent) -> Iterator[Cell]:
    """Yield logs with one effect of a confusable pair, on a distinguishable and on an ambiguous drive."""
    for k, pair in enumerate(alike.CONFUSABLE_PAIRS):
        for hidden in (pair.first, pair.second):
            if extent.names and not {pair.first.name, pair.second.name} & set(extent.names):
                continue
            for variant in alike.VARIANTS:
                for drive in range(extent.n_drives):
                    yield Cell(
                        "alike",
                        pair.name,
                        variant,
                        drive,
                        _list_seeds(extent, "alike", 10 * k + drive),
                        ((hidden.name, STRONG_NATS if variant == alike.VARIANTS[0] else MEDIUM_NATS),),
                    )


def _controls(extent: TableExtent) -> Iterator[Cell]:
    """Yield logs for comparisons: forced wrong names, and permuted temperatures."""
    for k, name in enumerate(CONTROL_EFFECTS):
        if extent.names and name not in extent.names:
            continue
        for drive in range(extent.n_drives):
            seeds = _list_seeds(extent, "controls", 10 * k + drive)
            yield Cell("controls", name, "strong", drive, seeds, ((name, STRONG_NATS),))
    for drive in range(extent.n_drives):
        seeds = _list_seeds(extent, "controls", 90 + drive)
        yield Cell("controls", "nothing", "permuted temperature", drive, seeds)


def _long(extent: TableExtent) -> Iterator[Cell]:
    """Yield drives of ten minutes with a radius error of 3 %, in which the wheel phase is lost."""
    for drive in range(extent.n_drives):
        yield Cell(
            "long",
            "wheel_radius",
            "3 %, 5 mm/s, 600 s",
            drive,
            _list_seeds(extent, "long", drive),
            (("wheel_radius", 0.0),),
            factor=10.0,
            options={"duration": 600.0, "speed_noise": 0.005},
        )
