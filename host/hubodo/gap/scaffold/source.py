"""The Python file of a new effect; its class is the one that was fitted."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from hubodo.effects import Effect
from hubodo.effects.loaded import run_effects
from hubodo.gap.scaffold.library import (
    HELPERS,
    HELPERS_WITH_MEMORY,
    TIME_STAMP,
    Shape,
    ShapeParameter,
    Target,
)

_MAX_SOURCE_LINE = 106
_USUAL_SCALES = {"rad/s": 0.01, "m/s²": 0.1, "s": 0.01}


@dataclass(frozen=True)
class Summand:
    """A summand of an effect: a shape applied to some targets."""

    shape: Shape
    targets: tuple[Target, ...]


@dataclass(frozen=True)
class Observation:
    """The observation of an effect in a log.

    where: channels and regimes that show the effect, as text
    values: text of each parameter with its sigma
    usual_sizes: usual size of each parameter
    """

    log: Path
    scope: str
    where: str
    values: Mapping[str, str]
    usual_sizes: Mapping[str, float]


def render_source(name: str, summands: Sequence[Summand], observation: Observation | None = None) -> str:
    """Return the text of the file; `observation` is None while the effect is being fitted."""
    named_summands = [
        _NamedSummand(summand, "" if not k else f"_{k + 1}") for k, summand in enumerate(summands)
    ]
    body = [
        *_render_fields(named_summands, observation),
        *_render_offset(named_summands),
        *_render_true_time(named_summands),
    ]
    helpers = [helper for helper in HELPERS if any(f"{helper}(" in line for line in body)]
    imports = ["from dataclasses import dataclass", *(["from pathlib import Path"] if observation else [])]
    imports += ["from typing import ClassVar", "", "import numpy as np", ""]
    imports += ["from hubodo.arrays import Array"] if any("Array" in line for line in body) else []
    imports += ["from hubodo.effects.base import Effect, Level, parameter"]
    if helpers:
        imports.append(f"from hubodo.effects.dependence import {', '.join(helpers)}")
    imports.append("from hubodo.effects.sensor_chain import SensorChain")
    lines = [*_render_head(name, observation), "", "from __future__ import annotations", "", *imports]
    if observation:
        lines += ["", f"LOG = Path({str(observation.log)!r})"]
    level = "wheel" if any(item.on_wheel for item in named_summands) else "node"
    lines += ["", "", "@dataclass(frozen=True)", f"class {class_name(name)}(Effect):"]
    lines += textwrap.indent(_render_formula(named_summands), "    ").splitlines()
    lines += ["", f'    name: ClassVar[str] = "{name}"', f'    level: ClassVar[Level] = "{level}"']
    lines += [f'    meaning: ClassVar[str] = "{name.replace("_", " ")}"']
    lines += ["    has_memory: ClassVar[bool] = True"] if set(helpers) & set(HELPERS_WITH_MEMORY) else []
    lines += body
    if observation:
        lines += ["", "", *_render_test(name, observation)]
    return "\n".join(lines) + "\n"


def class_name(name: str) -> str:
    """Return the class name of an effect, such as `BentAxle` for `bent_axle`."""
    return "".join(part.capitalize() for part in name.split("_"))


def compile_effect(name: str, summands: Sequence[Summand]) -> type[Effect]:
    """Return the class that the file of the effect would define."""
    return run_effects(render_source(name, summands), Path(f"{name}.py"))[0]


class _NamedSummand:
    """A summand with the names of its parameters in the class; `end`: suffix that makes them unique."""

    def __init__(self, summand: Summand, end: str) -> None:
        self.shape, self.targets = summand.shape, summand.targets
        self.places: dict[str, ShapeParameter] = {
            f"{place.name}{end}": place for place in self.shape.parameters
        }
        self.amplitudes = {
            target.name: [(f"{target.name}{suffix}{end}", wave) for suffix, wave in self.shape.amplitudes]
            for target in self.targets
        }
        self._end = end

    @property
    def on_wheel(self) -> bool:
        """Return True if the summand exists only for a node on a wheel."""
        return self.shape.needs_wheel or any(target.needs_wheel for target in self.targets)

    def text(self, expression: str) -> str:
        """Return an expression with the names that the parameters have in this class."""
        for place in self.shape.parameters:
            expression = re.sub(rf"self\.{place.name}\b", f"self.{place.name}{self._end}", expression)
        return expression

    def value(self, target: Target) -> str:
        """Return the expression that is added to a target."""
        weight, total = self.factors(target)
        if weight == "1.0":
            return total
        return f"{weight} * {total if ' + ' not in total else f'({total})'}"

    def factors(self, target: Target) -> tuple[str, str]:
        """Return the expressions of the weight and of the sum of waves."""
        parts = []
        for parameter, wave in self.amplitudes[target.name]:
            wave = self.text(wave)
            parts.append(f"self.{parameter}" if wave == "1.0" else f"self.{parameter} * {wave}")
        weight = self.text(self.shape.weight)
        simple = re.fullmatch(r"[\w.()]+(\*\*2)?", weight)
        return weight if simple else f"({weight})", " + ".join(parts)


def _render_head(name: str, observation: Observation | None) -> list[str]:
    if observation is None:
        return [f'"""The effect `{name}`."""']
    values = "; ".join(f"{key} {value}" for key, value in observation.values.items())
    use = f"To use it: --effects {name}.py with hubodo gap, simulate, fuse, record; to test it: pytest"
    paragraphs = (
        f"The effect `{name}`, found by hubodo gap in {observation.log.name}; no known effect explained it.",
        f"Seen on {observation.scope}: {observation.where}.",
        f"There: {values}.",
        f"{use} {name}.py.",
    )
    text = "\n\n".join(textwrap.fill(line, _MAX_SOURCE_LINE) for line in paragraphs)
    return [f'"""{text}', '"""']


def _render_formula(named: Sequence[_NamedSummand]) -> str:
    """Return the docstring: the sum that it adds, with plain names."""
    parts = []
    for one in named:
        for target in one.targets:
            value = re.sub(r"\b(self|chain|np)\.", "", one.value(target)).replace("**2", "²")
            parts.append(f"{target.name} += {value}: {one.shape.description}.")
    text = "\n".join(textwrap.fill(part, _MAX_SOURCE_LINE - 4) for part in parts)
    return f'"""{text}"""' if len(parts) == 1 and "\n" not in text else f'"""{text}\n"""'


def _render_fields(named: Sequence[_NamedSummand], observation: Observation | None) -> list[str]:
    lines = []
    usual_sizes = observation.usual_sizes if observation else {}
    for one in named:
        for target in one.targets:
            unit = f"{target.unit} per {one.shape.weight_unit}" if one.shape.weight_unit else target.unit
            for key, _ in one.amplitudes[target.name]:
                scale = usual_sizes.get(key) or _USUAL_SCALES[target.unit]
                turned = ", flips_with_facing=True" if target.is_mirrored else ""
                lines.append(f'    {key}: float = parameter("{unit}", {scale:.2g}{turned})')
        for key, place in one.places.items():
            more = "" if place.fitted else ", fitted=False"
            value = usual_sizes.get(f"{key}=", place.value)
            lines.append(
                f'    {key}: float = parameter("{place.unit}", {place.scale:.2g}, default={value:.9g}{more})'
            )
    return lines


def _render_offset(named: Sequence[_NamedSummand]) -> list[str]:
    lines: list[str] = []
    for one in named:
        for target in one.targets:
            if target is TIME_STAMP:
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


def _render_true_time(named: Sequence[_NamedSummand]) -> list[str]:
    delays = [one.value(target) for one in named for target in one.targets if target is TIME_STAMP]
    if not delays:
        return []
    total = " + ".join(delays).replace("chain.t", "t")
    return ["", "    def true_time(self, t: Array) -> Array:", f"        return t - ({total})"]


def _channel(row: int) -> str:
    return f"chain.gyro[{row}]" if row < 3 else f"chain.accel[{row - 3}]"


def _render_test(name: str, observation: Observation) -> list[str]:
    return [
        "def test_the_log_shows_it_where_it_was_not_fitted() -> None:",
        "    from hubodo.gap.scaffold.proof import held_out_gaps",
        "",
        '    model = Path(__file__).with_name("model.toml")',
        f'    without, with_it = held_out_gaps(LOG, model, {class_name(name)}(), "{observation.scope}")',
        "    assert with_it < without",
    ]
