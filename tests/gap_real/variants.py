"""Real drives that are shorter, slower or damaged, judged with a model of another drive: nothing is missing.

    python tests/gap_real/variants.py [--models out/gap-real] [--variants 40_hz,lost]

The models are those that `real.py` learnt on drive-1 and drive-2. Nothing is injected, so each name of the
vehicle is wrong. The trivial baseline names nothing.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).resolve().parents[1]), str(Path(__file__).resolve().parent)]

from car import read_drive  # noqa: E402

from hubodo.arrays import Array  # noqa: E402
from hubodo.gap.explain.unnamed import is_unnamed  # noqa: E402
from hubodo.gap.workflow import find_gap  # noqa: E402
from hubodo.model.model_file import read_model  # noqa: E402
from hubodo.recording import Recording, Table  # noqa: E402

MODEL_OF = {"drive-1": "drive-2", "drive-2": "drive-1"}
SEED, LOST_SHARE = 5, 0.05
# s; of a pause, before the end of the other node, and of a clock that counts from 1970.
PAUSE, EARLY_END, EPOCH = (60.0, 63.0), 20.0, 1.7e9
TableChange = Callable[[str, Table], Table]


def _select(choose: Callable[[str, Array], Array]) -> TableChange:
    """Return a change that selects samples by node and times, as a mask or as indices."""

    def change(name: str, table: Table) -> Table:
        chosen = choose(name, table.t)
        return Table({column: table[column][chosen] for column in table})

    return change


def _decimate(rate_hz: float) -> TableChange:
    def choose(name: str, t: Array) -> Array:
        return np.unique(np.searchsorted(t, np.arange(t[0], t[-1], 1.0 / rate_hz)))

    return _select(choose)


def _start_late(name: str, table: Table) -> Table:
    return Table({column: table[column] + EPOCH * (column == "t") for column in table})


def list_variants() -> Mapping[str, TableChange]:
    """Return the changes of a recording by name."""
    rng = np.random.default_rng(SEED)
    return {
        "60_hz": _decimate(60.0),
        "40_hz": _decimate(40.0),
        "lost": _select(lambda name, t: rng.random(len(t)) > LOST_SHARE),
        "pause": _select(lambda name, t: (t < PAUSE[0]) | (t > PAUSE[1])),
        "pause_left": _select(lambda name, t: (name != "left") | (t < PAUSE[0]) | (t > PAUSE[1])),
        "left_ends": _select(lambda name, t: (name != "left") | (t < t[-1] - EARLY_END)),
        "right_ends": _select(lambda name, t: (name != "right") | (t < t[-1] - EARLY_END)),
        "epoch": _start_late,
    }


def read_variant(name: str) -> tuple[str, Recording]:
    """Return the drive and the recording of a variant: of drive-2, or a half such as `drive-1/first`."""
    if "/" in name:
        return name.partition("/")[0], read_drive(name)
    recording, change = read_drive("drive-2"), list_variants()[name]
    nodes = {node: change(node, table) for node, table in recording.nodes.items()}
    return "drive-2", replace(recording, nodes=nodes)


def list_names() -> Iterator[str]:
    """Yield the names of all variants."""
    yield from list_variants()
    yield from (f"{drive}/{half}" for drive in MODEL_OF for half in ("first", "second"))


def main(arguments: Sequence[str] | None = None) -> int:
    """Judge each variant, and print what was named."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--models", type=Path, default=Path("out/gap-real"))
    parser.add_argument("--variants", default=",".join(list_names()))
    options = parser.parse_args(arguments)
    n_wrong, n_grown, names = 0, 0, options.variants.split(",")
    for name in names:
        start = time.monotonic()
        drive, recording = read_variant(name)
        result = find_gap(recording, read_model(options.models / f"{MODEL_OF[drive]}.toml"))
        wrong = [one for one in result.found if not one.belongs_to_drive and not is_unnamed(one)]
        n_wrong, n_grown = n_wrong + len(wrong), n_grown + (result.gap.after > result.gap.before)
        listed = ", ".join(f"{one.effect}/{one.scope} {one.confidence:.2f}" for one in result.listed)
        print(
            f"{name:16} gap {result.gap.before:.3f} -> {result.gap.after:.3f}  "
            f"{time.monotonic() - start:4.0f} s  {listed}",
            flush=True,
        )
    print(f"names of the vehicle: {n_wrong} in {len(names)} (seed {SEED}); gap larger than before: {n_grown}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
