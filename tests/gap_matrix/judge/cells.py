"""Cells of all tables: the hidden effects, the drive and the seed of each log."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import numpy as np

from gap_matrix import alike, effects, outside
from gap_matrix.dose import MEDIUM, STRENGTHS, STRONG

TABLES = ("singles", "nulls", "pairs", "open", "alike", "controls", "long")
SEEDS = {"development": effects.DEVELOPMENT_SEEDS, "test": effects.TEST_SEEDS}
PAIR_LIST_SEED = 20
# Each table begins elsewhere in its thousand seeds; where a drive cannot show an effect, the spares follow.
_FIRST = {"singles": 0, "nulls": 400, "pairs": 600, "open": 700, "alike": 800, "controls": 900, "long": 980}
_SPARES, _APART = 4, 37
CONTROLLED = (
    "gyro_temperature", "gyro_g_sensitivity", "gyro_scale_factor", "node_misalignment",
    "lever_arm", "wheel_radius", "wheel_camber", "time_offset",
)  # fmt: skip


@dataclass(frozen=True)
class Cell:
    """One log to diagnose.

    name: effect, pair or kind. variant: strength or drive. seeds: the first that can show what is hidden is
    taken. hidden: names and nats. factor: times the typical size, instead of nats. options: for
    `cases.setup`.
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
        hidden = f", {self.hidden[0][0]} hidden" if self.table == "alike" else ""
        return f"{self.table}/{self.name}{hidden}/{self.variant}/{self.drive}/{self.seeds[0]}"


@dataclass(frozen=True)
class Wanted:
    """The extent of each table; names: only these effects (kinds in the open set), default all."""

    tables: Sequence[str] = TABLES
    seeds: str = "development"
    names: Sequence[str] = ()
    strengths: Sequence[str] = tuple(STRENGTHS)
    drives: int = 5
    nulls: int = 200
    pairs: int = 40


def cells(wanted: Wanted) -> list[Cell]:
    """Return all cells of the requested tables, in their order."""
    makers = {
        "singles": _singles,
        "nulls": _nulls,
        "pairs": _pairs,
        "open": _open,
        "alike": _alike,
        "controls": _controls,
        "long": _long,
    }
    return [cell for table in TABLES if table in wanted.tables for cell in makers[table](wanted)]


def _seeds(wanted: Wanted, table: str, number: int) -> tuple[int, ...]:
    found = SEEDS[wanted.seeds]
    return tuple(found[(_FIRST[table] + number + _APART * k) % len(found)] for k in range(_SPARES))


def _singles(wanted: Wanted) -> Iterator[Cell]:
    """Yield the same drives and noise for each strength of an effect."""
    for k, name in enumerate(effects.KINDS):
        if wanted.names and name not in wanted.names:
            continue
        for strength in wanted.strengths:
            for drive in range(wanted.drives):
                seeds = _seeds(wanted, "singles", 10 * k + drive)
                yield Cell("singles", name, strength, drive, seeds, ((name, STRENGTHS[strength]),))


def _nulls(wanted: Wanted) -> Iterator[Cell]:
    """Yield drives of one to four minutes.

    Every tenth is a bench, every tenth a turntable, every fourth has effects that the model file declares.
    """
    for k in range(wanted.nulls):
        kind = {4: "bench", 9: "turntable"}.get(k % 10, "drive")
        known = ["lever_arm", "gyro_scale_factor"] if k % 4 == 2 else []
        variant = f"{kind}, declared effects" if known else kind
        yield Cell(
            "nulls", "nothing", variant, k, _seeds(wanted, "nulls", k), options={"kind": kind, "known": known}
        )


def pair_list(count: int) -> list[tuple[tuple[str, float], tuple[str, float]]]:
    """Return the first `count` pairs of the fixed list: two names with their gains from medium to strong."""
    rng = np.random.default_rng(PAIR_LIST_SEED)
    everything = list(combinations(effects.KINDS, 2))
    made = []
    for k in rng.permutation(len(everything))[:count]:
        nats = np.exp(rng.uniform(np.log(MEDIUM), np.log(STRONG), 2)).round(0).tolist()
        one, other = everything[k]
        made.append(((one, nats[0]), (other, nats[1])))
    return made


def _pairs(wanted: Wanted) -> Iterator[Cell]:
    for k, hidden in enumerate(pair_list(wanted.pairs)):
        names = [name for name, _ in hidden]
        if not wanted.names or set(names) & set(wanted.names):
            yield Cell("pairs", " + ".join(names), "both", k, _seeds(wanted, "pairs", k), hidden)


def _open(wanted: Wanted) -> Iterator[Cell]:
    for k, name in enumerate(outside.KINDS):
        if wanted.names and name not in wanted.names:
            continue
        for strength in [s for s in wanted.strengths if s in outside.NATS]:
            for drive in range(wanted.drives):
                yield Cell("open", name, strength, drive, _seeds(wanted, "open", 10 * k + drive))


def _alike(wanted: Wanted) -> Iterator[Cell]:
    for k, pair in enumerate(alike.PAIRS):
        for hidden in (pair.one, pair.other):
            if wanted.names and not {pair.one.name, pair.other.name} & set(wanted.names):
                continue
            for where in alike.DRIVES:
                for drive in range(wanted.drives):
                    yield Cell(
                        "alike",
                        pair.name,
                        where,
                        drive,
                        _seeds(wanted, "alike", 10 * k + drive),
                        ((hidden.name, STRONG if where == alike.DRIVES[0] else MEDIUM),),
                    )


def _controls(wanted: Wanted) -> Iterator[Cell]:
    for k, name in enumerate(CONTROLLED):
        if wanted.names and name not in wanted.names:
            continue
        for drive in range(wanted.drives):
            seeds = _seeds(wanted, "controls", 10 * k + drive)
            yield Cell("controls", name, "strong", drive, seeds, ((name, STRONG),))
    for drive in range(wanted.drives):
        seeds = _seeds(wanted, "controls", 90 + drive)
        yield Cell("controls", "nothing", "permuted temperature", drive, seeds)


def _long(wanted: Wanted) -> Iterator[Cell]:
    """Yield drives of ten minutes with a radius error of 3 %, in which a wheel is lost."""
    for drive in range(wanted.drives):
        yield Cell(
            "long",
            "wheel_radius",
            "3 %, 5 mm/s, 600 s",
            drive,
            _seeds(wanted, "long", drive),
            (("wheel_radius", 0.0),),
            factor=10.0,
            options={"duration": 600.0, "speed_noise": 0.005},
        )
