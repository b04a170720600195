"""Write the tables of effects in host/hubodo/model/README.md from the classes in host/hubodo/effects."""

import sys
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "host"))

from generated import fill, write_or_check  # noqa: E402
from hubodo.effects import EFFECTS, Effect  # noqa: E402
from hubodo.effects.field import FIELD_EFFECTS  # noqa: E402

README = ROOT / "host" / "hubodo" / "model" / "README.md"
_UNITS = {"1": "", "1e-6": "ppm", "noise": "× noise"}
_STAGES = {
    "adjust_geometry": "motion",
    "rotate_into_node": "1",
    "low_pass_rate": "2",
    "add_scale_errors": "3",
    "add_offsets": "4",
    "add_random_walk": "4",
    "add_outliers": "5",
    "clip_readings": "6",
    "quantize_readings": "6",
    "repeat_samples": "7",
    "true_time": "7",
}
_EFFECT = ("effect", "level", "parameters", "visible in", "stage", "description")
_CONFUSABLE = ("effect", "confusable with", "manoeuvre that distinguishes them")


def readme_blocks() -> dict[str, str]:
    """Return the tables by the name of their markers."""
    return {
        "effects": _table(_EFFECT, _effects(EFFECTS)),
        "field": _table(_EFFECT, _effects(FIELD_EFFECTS)),
        "estimates": _table(
            ("parameter", "prior 1σ", "random walk per √s", "origin of the numbers"), _estimates()
        ),
        "look-alikes": _table(_CONFUSABLE, _look_alikes(EFFECTS)),
        "field look-alikes": _table(_CONFUSABLE, _look_alikes(FIELD_EFFECTS)),
    }


def _table(head: tuple[str, ...], rows: Iterator[tuple[str, ...]]) -> str:
    lines = [f"| {' | '.join(row)} |" for row in (head, *rows)]
    return "\n".join([lines[0], "|" + "---|" * len(head), *lines[1:]])


def _effects(kinds: tuple[type[Effect], ...]) -> Iterator[tuple[str, ...]]:
    for kind in kinds:
        parts = []
        for unit, names in groupby(kind.parameters(), kind.unit):
            listed = ", ".join(
                f"{'−' if kind.facing_sign_of(name, 'right') < 0.0 else ''}`{name}`" for name in names
            )
            parts.append(f"{listed} {_UNITS.get(unit, unit)}".rstrip())
        stage = _stage(kind) + (", invertible" if kind.is_invertible else "")
        yield f"`{kind.name}`", kind.level, "; ".join(parts), kind.visible_in, stage, _sentence(kind)


def _stage(kind: type[Effect]) -> str:
    """Return the stage at which an effect enters: the first one that it overrides."""
    own = (label for stage, label in _STAGES.items() if getattr(kind, stage) is not getattr(Effect, stage))
    return next(own)


def _sentence(kind: type[Effect]) -> str:
    """Return the first sentence of the docstring of a class, on one line."""
    first = (kind.__doc__ or "").partition("\n\n")[0]
    return " ".join(first.split())


def _estimates() -> Iterator[tuple[str, ...]]:
    for kind in EFFECTS:
        for prior, names in groupby(kind.parameters(), kind.odometry_prior):
            if prior is not None:
                listed = list(names)
                unit = _UNITS.get(kind.unit(listed[0]), kind.unit(listed[0]))
                walk = f"{prior.random_walk:.2g}" if prior.random_walk else "none"
                which = f"`{kind.name}` {', '.join(f'`{name}`' for name in listed)}"
                yield which, f"{prior.sigma:.2g} {unit}".rstrip(), walk, prior.origin


def _look_alikes(kinds: tuple[type[Effect], ...]) -> Iterator[tuple[str, ...]]:
    for kind in kinds:
        for other, manoeuvre in kind.confusable_with.items():
            yield f"`{kind.name}`", f"`{other}`", manoeuvre


def generate_files() -> dict[Path, str]:
    """Return the README with its generated text."""
    return {README: fill(README.read_text(encoding="utf-8"), readme_blocks())}


if __name__ == "__main__":
    sys.exit(write_or_check(generate_files, ROOT, "tools/gen_tables.py", __doc__, None))
