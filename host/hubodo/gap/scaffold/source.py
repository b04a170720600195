"""The Python file of a new effect: what is written is what was fitted."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from hubodo.effects import Effect
from hubodo.effects.loaded import run_effects
from hubodo.gap.scaffold.library import HELPERS, REMEMBERING, STAMP, Shape, ShapePlace, Target

_WIDE = 106
_SCALES = {"rad/s": 0.01, "m/s²": 0.1, "s": 0.01}


@dataclass(frozen=True)
class Summand:
    """A shape on some targets."""

    shape: Shape
    targets: tuple[Target, ...]


@dataclass(frozen=True)
class SeenIn:
    """What a log showed of an effect, in words. values: of each parameter, with its sigma, by name."""

    log: Path
    scope: str
    where: str
    values: Mapping[str, str]
    usual: Mapping[str, float]


def source(name: str, summands: Sequence[Summand], seen: SeenIn | None = None) -> str:
    """The text of the file. seen: None while it is being fitted."""
    named = [_Named(summand, "" if not k else f"_{k + 1}") for k, summand in enumerate(summands)]
    body = [*_fields(named, seen), *_offset(named), *_true_time(named)]
    helpers = [it for it in HELPERS if any(f"{it}(" in line for line in body)]
    imports = ["from dataclasses import dataclass", *(["from pathlib import Path"] if seen else [])]
    imports += ["from typing import ClassVar", "", "import numpy as np", ""]
    imports += ["from hubodo.arrays import Array"] if any("Array" in line for line in body) else []
    imports += ["from hubodo.effects.base import Effect, Level, SensorChain, parameter"]
    if helpers:
        imports.append(f"from hubodo.effects.dependence import {', '.join(helpers)}")
    lines = [*_head(name, seen), "", "from __future__ import annotations", "", *imports]
    if seen:
        lines += ["", f"LOG = Path({str(seen.log)!r})"]
    level = "wheel" if any(one.on_wheel for one in named) else "node"
    lines += ["", "", "@dataclass(frozen=True)", f"class {class_name(name)}(Effect):"]
    lines += textwrap.indent(_formula(named), "    ").splitlines()
    lines += ["", f'    name: ClassVar[str] = "{name}"', f'    level: ClassVar[Level] = "{level}"']
    lines += [f'    meaning: ClassVar[str] = "{name.replace("_", " ")}"']
    lines += ["    has_memory: ClassVar[bool] = True"] if set(helpers) & set(REMEMBERING) else []
    lines += body
    if seen:
        lines += ["", "", *_test(name, seen)]
    return "\n".join(lines) + "\n"


def class_name(name: str) -> str:
    """`bent_axle` as `BentAxle`."""
    return "".join(part.capitalize() for part in name.split("_"))


def as_class(name: str, summands: Sequence[Summand]) -> type[Effect]:
    """The effect that the file would define."""
    return run_effects(source(name, summands), Path(f"{name}.py"))[0]


class _Named:
    """A summand with the names that its parameters have in the class; end: what sets them apart."""

    def __init__(self, summand: Summand, end: str) -> None:
        self.shape, self.targets = summand.shape, summand.targets
        self.places: dict[str, ShapePlace] = {f"{place.name}{end}": place for place in self.shape.places}
        self.amplitudes = {
            target.name: [(f"{target.name}{suffix}{end}", wave) for suffix, wave in self.shape.waves]
            for target in self.targets
        }
        self._end = end

    @property
    def on_wheel(self) -> bool:
        return self.shape.of_wheel or any(target.on_wheel for target in self.targets)

    def text(self, expression: str) -> str:
        """An expression with this class's names for the places."""
        for place in self.shape.places:
            expression = re.sub(rf"self\.{place.name}\b", f"self.{place.name}{self._end}", expression)
        return expression

    def value(self, target: Target) -> str:
        """What is added to a target."""
        weight, total = self.factors(target)
        if weight == "1.0":
            return total
        return f"{weight} * {total if ' + ' not in total else f'({total})'}"

    def factors(self, target: Target) -> tuple[str, str]:
        """The same as weight and waves."""
        parts = []
        for parameter, wave in self.amplitudes[target.name]:
            wave = self.text(wave)
            parts.append(f"self.{parameter}" if wave == "1.0" else f"self.{parameter} * {wave}")
        weight = self.text(self.shape.weight)
        simple = re.fullmatch(r"[\w.()]+(\*\*2)?", weight)
        return weight if simple else f"({weight})", " + ".join(parts)


def _head(name: str, seen: SeenIn | None) -> list[str]:
    if seen is None:
        return [f'"""The effect `{name}`."""']
    values = "; ".join(f"{key} {value}" for key, value in seen.values.items())
    use = f"To use it: --effects {name}.py with hubodo gap, simulate, fuse, record; to test it: pytest"
    words = (
        f"The effect `{name}`: what hubodo gap found in {seen.log.name}; nothing that it knew explained it.",
        f"Seen on {seen.scope}: {seen.where}.",
        f"There: {values}.",
        f"{use} {name}.py.",
    )
    text = "\n\n".join(textwrap.fill(line, _WIDE) for line in words)
    return [f'"""{text}', '"""']


def _formula(named: Sequence[_Named]) -> str:
    """A docstring: the sum that it adds, with plain names."""
    parts = []
    for one in named:
        for target in one.targets:
            value = re.sub(r"\b(self|chain|np)\.", "", one.value(target)).replace("**2", "²")
            parts.append(f"{target.name} += {value}: {one.shape.words}.")
    text = "\n".join(textwrap.fill(part, _WIDE - 4) for part in parts)
    return f'"""{text}"""' if len(parts) == 1 and "\n" not in text else f'"""{text}\n"""'


def _fields(named: Sequence[_Named], seen: SeenIn | None) -> list[str]:
    lines = []
    usual = seen.usual if seen else {}
    for one in named:
        for target in one.targets:
            unit = f"{target.unit} per {one.shape.per}" if one.shape.per else target.unit
            for key, _ in one.amplitudes[target.name]:
                scale = usual.get(key) or _SCALES[target.unit]
                turned = ", flips_with_facing=True" if target.turned else ""
                lines.append(f'    {key}: float = parameter("{unit}", {scale:.2g}{turned})')
        for key, place in one.places.items():
            more = "" if place.fitted else ", fitted=False"
            value = usual.get(f"{key}=", place.value)
            lines.append(
                f'    {key}: float = parameter("{place.unit}", {place.scale:.2g}, default={value:.9g}{more})'
            )
    return lines


def _offset(named: Sequence[_Named]) -> list[str]:
    lines: list[str] = []
    for one in named:
        for target in one.targets:
            if target is STAMP:
                continue
            weight, total = one.factors(target)
            lines.append(f"        {target.name} = {total}")
            if weight != "1.0":
                lines.append(f"        {target.name} = {weight} * {target.name}")
            if len(target.rows) == 1 and target.rows[0][1] == "1.0":
                lines.append(f"        {_channel(target.rows[0][0])} += {target.name}")
                continue
            for row, by in target.rows:
                sign, by = ("-=", by[1:]) if by.startswith("-") else ("+=", by)
                lines.append(f"        {_channel(row)} {sign} {by} * {target.name}")
    return ["", "    def add_offsets(self, chain: SensorChain) -> None:", *lines] if lines else []


def _true_time(named: Sequence[_Named]) -> list[str]:
    delays = [one.value(target) for one in named for target in one.targets if target is STAMP]
    if not delays:
        return []
    total = " + ".join(delays).replace("chain.t", "t")
    return ["", "    def true_time(self, t: Array) -> Array:", f"        return t - ({total})"]


def _channel(row: int) -> str:
    return f"chain.gyro[{row}]" if row < 3 else f"chain.accel[{row - 3}]"


def _test(name: str, seen: SeenIn) -> list[str]:
    return [
        "def test_the_log_shows_it_where_it_was_not_fitted() -> None:",
        "    from hubodo.gap.scaffold.proof import held_out_gaps",
        "",
        '    model = Path(__file__).with_name("model.toml")',
        f'    without, with_it = held_out_gaps(LOG, model, {class_name(name)}(), "{seen.scope}")',
        "    assert with_it < without",
    ]
