"""Two wheels whose samples are damaged: error and NEES by kind of damage, on random drives.

    python tests/accuracy/damaged_samples.py [--drives 12] [--first-seed 7000]

The drives are those of mixed.py. Damage is of the left node, or of both for "both frozen": glitches are a bus
that reads -32.768 rad/s in one of a hundred samples, garbage are 30 random samples in a row, frozen nodes
repeat a sample for three seconds while the vehicle moves, "silent" loses these seconds; "stuck" and "half
rate" are a gyro that repeats its rate about the axle, or reads half of all rates, from then on. Error at the
end in % of the distance; NEES of x, y and heading, 3 if consistent.
"""

# ruff: noqa: E402 (BLAS must know its threads before numpy is loaded)

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

import numpy as np

from generators.mixed_drives import drawn
from generators.wheel_drives import WheelDrive
from hubodo.fuse.wheel.node_screening import screen_samples
from hubodo.fuse.wheel.track import run_wheel_filter
from script_arguments import script_parser
from wheel_runs import config, end_error, nees, tables

MIN_ROLLING_RATE = 1.0  # rad/s, of a wheel that is damaged while it turns
FROZEN_S, GLITCH_SHARE, GLITCH, GARBAGE_SAMPLES, GARBAGE = 3.0, 0.01, -32.768, 30, 30.0

Samples = dict[str, np.ndarray]
"""t (N,) s, gyro (N, 3) rad/s, accel (N, 3) m/s² of a node."""


def unchanged(samples: Samples, span: slice, rng: np.random.Generator) -> None:
    """Leave the samples as they are."""


def glitches(samples: Samples, span: slice, rng: np.random.Generator) -> None:
    """Let one axis of single samples read one value."""
    rows = np.flatnonzero(rng.random(len(samples["t"])) < GLITCH_SHARE)
    samples["gyro"][rows, rng.integers(0, 3, len(rows))] = GLITCH


def garbage(samples: Samples, span: slice, rng: np.random.Generator) -> None:
    """Replace samples in a row by random numbers."""
    for name in ("gyro", "accel"):
        samples[name][span.start : span.start + GARBAGE_SAMPLES] = rng.uniform(
            -GARBAGE, GARBAGE, (GARBAGE_SAMPLES, 3)
        )


def frozen(samples: Samples, span: slice, rng: np.random.Generator) -> None:
    """Repeat one sample."""
    for name in ("gyro", "accel"):
        samples[name][span] = samples[name][span.start]


def silent(samples: Samples, span: slice, rng: np.random.Generator) -> None:
    """Remove the samples."""
    for name in tuple(samples):
        samples[name] = np.delete(samples[name], span, axis=0)


def stuck(samples: Samples, span: slice, rng: np.random.Generator) -> None:
    """Repeat the rate about the axle to the end."""
    samples["gyro"][span.start :, 2] = samples["gyro"][span.start, 2]


def half_rate(samples: Samples, span: slice, rng: np.random.Generator) -> None:
    """Halve all rates to the end, as of a chip that returned to another range."""
    samples["gyro"][span.start :] *= 0.5


KINDS: tuple[tuple[str, Callable[..., None], tuple[str, ...]], ...] = (
    ("as recorded", unchanged, ()),
    ("glitches", glitches, ("left",)),
    ("garbage", garbage, ("left",)),
    ("frozen", frozen, ("left",)),
    ("silent", silent, ("left",)),
    ("both frozen", frozen, ("left", "right")),
    ("both silent", silent, ("left", "right")),
    ("stuck", stuck, ("left",)),
    ("half rate", half_rate, ("left",)),
)


def damaged_drive(seed: int, damage: Callable[..., None], names: tuple[str, ...]) -> WheelDrive:
    """Return a random drive with damaged samples of some nodes."""
    drive, rng = drawn(seed).drive, np.random.default_rng([seed, 71])
    early = drive.nodes["left"].t < drive.t[-1] - 2.0 * FROZEN_S
    t, rate = drive.nodes["left"].t[early], np.abs(drive.nodes["left"].gyro[early, 2])
    start = rng.choice(t[rate >= min(MIN_ROLLING_RATE, rate.max())])
    nodes = dict(drive.nodes)
    for name in names:
        node = nodes[name]
        samples = {"t": node.t.copy(), "gyro": node.gyro.copy(), "accel": node.accel.copy()}
        damage(samples, slice(*np.searchsorted(node.t, (start, start + FROZEN_S))), rng)
        nodes[name] = replace(node, **samples)
    return replace(drive, nodes=nodes)


def main() -> int:
    """Print a line for each kind of damage."""
    args = script_parser(__doc__, drives=12, first_seed=7000).parse_args()
    seeds = range(args.first_seed, args.first_seed + args.drives)
    print(f"seeds {seeds[0]} to {seeds[-1]}")
    print(f"{'damage':14}{'median':>9}{'mean':>9}{'largest':>9}{'NEES of 3':>11}{'largest':>9}")
    for kind, damage, names in KINDS:
        rows = []
        for seed in seeds:
            drive = damaged_drive(seed, damage, names)
            screened, _ = screen_samples(tables(drive))
            run = run_wheel_filter(config(drive), screened)
            rows.append((100.0 * end_error(drive, run) / drive.length, nees(drive, run)))
        error, nees_values = np.array(rows).T
        print(
            f"{kind:14}{np.median(error):9.3f}{error.mean():9.3f}{error.max():9.3f}"
            f"{nees_values.mean():11.2f}{nees_values.max():9.1f}",
            flush=True,
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
