"""Writes the tables of effects in host/hubodo/model/README.md from the classes in host/hubodo/effects."""

import sys
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "host"))

from generated import fill, write_or_check  # noqa: E402
from hubodo.effects import EFFECTS, Effect  # noqa: E402
from hubodo.effects.field import FIELD  # noqa: E402

README = ROOT / "host" / "hubodo" / "model" / "README.md"
_UNITS = {"1": "", "1e-6": "ppm", "noise": "× noise"}
_STAGES = {
    "shape": "motion",
    "mount": "1",
    "low_pass": "2",
    "respond": "3",
    "offset": "4",
    "wander": "4",
    "scatter": "5",
    "clip": "6",
    "digitize": "6",
    "repeat": "7",
    "true_time": "7",
}
_EFFECT = ("effect", "level", "parameters", "shows in", "stage", "what it is")
_ALIKE = ("effect", "may pass for", "what tells them apart")


def readme_blocks() -> dict[str, str]:
    """The tables by the name of their markers."""
    return {
        "effects": _table(_EFFECT, _effects(EFFECTS)),
        "field": _table(_EFFECT, _effects(FIELD)),
        "estimates": _table(("parameter", "1 σ before", "walk per √s", "where they come from"), _estimates()),
        "look-alikes": _table(_ALIKE, _look_alikes(EFFECTS)),
        "field look-alikes": _table(_ALIKE, _look_alikes(FIELD)),
    }


def _table(head: tuple[str, ...], rows: Iterator[tuple[str, ...]]) -> str:
    lines = [f"| {' | '.join(row)} |" for row in (head, *rows)]
    return "\n".join([lines[0], "|" + "---|" * len(head), *lines[1:]])


def _effects(kinds: tuple[type[Effect], ...]) -> Iterator[tuple[str, ...]]:
    for kind in kinds:
        parts = []
        for unit, names in groupby(kind.parameters(), kind.unit):
            listed = ", ".join(f"{'−' if kind.sign(name, 'right') < 0.0 else ''}`{name}`" for name in names)
            parts.append(f"{listed} {_UNITS.get(unit, unit)}".rstrip())
        stage = _stage(kind) + (", undone" if kind.undone else "")
        yield f"`{kind.name}`", kind.level, "; ".join(parts), kind.shows, stage, _sentence(kind)


def _stage(kind: type[Effect]) -> str:
    """Where an effect enters: the first stage that it does not leave as it is."""
    own = (words for stage, words in _STAGES.items() if getattr(kind, stage) is not getattr(Effect, stage))
    return next(own)


def _sentence(kind: type[Effect]) -> str:
    """What stands first in the words of a class, on one line."""
    first = (kind.__doc__ or "").partition("\n\n")[0]
    return " ".join(first.split())


def _estimates() -> Iterator[tuple[str, ...]]:
    for kind in EFFECTS:
        for found, names in groupby(kind.parameters(), kind.estimate):
            if found is not None:
                listed = list(names)
                unit = _UNITS.get(kind.unit(listed[0]), kind.unit(listed[0]))
                walk = f"{found.walk:.2g}" if found.walk else "none"
                which = f"`{kind.name}` {', '.join(f'`{name}`' for name in listed)}"
                yield which, f"{found.prior:.2g} {unit}".rstrip(), walk, found.origin


def _look_alikes(kinds: tuple[type[Effect], ...]) -> Iterator[tuple[str, ...]]:
    for kind in kinds:
        for other, manoeuvre in kind.alike.items():
            yield f"`{kind.name}`", f"`{other}`", manoeuvre


def outputs() -> dict[Path, str]:
    """The README with the text it should have."""
    return {README: fill(README.read_text(encoding="utf-8"), readme_blocks())}


if __name__ == "__main__":
    sys.exit(write_or_check(outputs, ROOT, "tools/gen_tables.py", __doc__, None))
