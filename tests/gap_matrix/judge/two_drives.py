"""Two drives of one vehicle: result of `gap --before --after` with and without a change.

    python tests/gap_matrix/judge/two_drives.py [--nulls 60] [--changes 10] [--first 0] [--seconds 90]

The p-values of pairs in which nothing has changed are uniform: their quantiles are printed, with the
Kolmogorov-Smirnov test of that. Then effects are changed between the drives, strong ones, and it is counted
how often they are named.
"""

# ruff: noqa: E402 (BLAS must know its threads before numpy is loaded)

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# The package is found from its parent; this folder itself must not stand on the path, or its names would.
sys.path[:0] = [str(Path(__file__).resolve().parents[2])]

import tempfile

import numpy as np
from scipy.stats import kstest

from gap_matrix import cases, recording
from gap_matrix.cases import Setup
from gap_matrix.dose import STRENGTHS, Meter
from gap_matrix.effects import SIDES, Effect
from hubodo.gap.change.change import ChangeResult, find_change
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model

# In both drives of every second pair, so that there is something that has not changed.
LASTING = "lever_arm"
# A knocked sensor, a worn tyre, a node put on askew, a wheel knocked out of true.
CHANGES = ("lever_arm", "wheel_radius", "node_misalignment", "wheel_camber", "gyro_scale_factor")
_OTHER = 100_000


def pair(seed: int, seconds: float, rate_hz: float | None = None) -> tuple[Setup, Setup]:
    """Return one vehicle on two drives; `rate_hz`: of all nodes, default drawn."""
    first, other = cases.setup(seed, duration=seconds), cases.setup(_OTHER + seed, duration=seconds)
    noise = {
        side: replace(
            other.noise[side],
            gyro=first.noise[side].gyro,
            accel=first.noise[side].accel,
            vibration=first.noise[side].vibration,
        )
        for side in SIDES
    }
    second = replace(other, radius=first.radius, track=first.track, facing=first.facing, noise=noise)
    if rate_hz is None:
        return first, second
    rng = np.random.default_rng(seed)
    return cases.sampled_at(first, rate_hz, rng), cases.sampled_at(second, rate_hz, rng)


def compared(
    setups: Sequence[Setup], before: Sequence[Effect], after: Sequence[Effect], folder: Path
) -> ChangeResult:
    """Return the comparison of two drives with these effects."""
    for setup, hidden, name in zip(setups, (before, after), ("before", "after"), strict=True):
        recording.write(setup, hidden, folder / name, {})
    logs = [read_folder(folder / name) for name in ("before", "after")]
    return find_change(*logs, read_model(folder / "before" / "model.toml"))


def null(seed: int, seconds: float, folder: Path, rate_hz: float | None = None) -> ChangeResult:
    """Compare two drives without a change."""
    setups = pair(seed, seconds, rate_hz)
    lasting = []
    if seed % 2:
        drawn = cases.hidden_effect(setups[0], LASTING)
        lasting = [Meter(setups[0]).dose(drawn, STRENGTHS["strong"])[0]]
    return compared(setups, lasting, lasting, folder)


def changed(
    name: str, seed: int, seconds: float, folder: Path, rate_hz: float | None = None
) -> tuple[Effect, ChangeResult]:
    """Compare two drives with one more effect in the second."""
    setups = pair(seed, seconds, rate_hz)
    hidden = Meter(setups[1]).dose(cases.hidden_effect(setups[1], name), STRENGTHS["strong"])[0]
    return hidden, compared(setups, [], [hidden], folder)


def main() -> int:
    """Print both tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--nulls", type=int, default=60)
    parser.add_argument("--changes", type=int, default=4, help="of each kind")
    parser.add_argument("--first", type=int, default=0, help="seed")
    parser.add_argument("--seconds", type=float, default=90.0)
    args = parser.parse_args()
    p_values, names = [], 0
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(args.first, args.first + args.nulls):
            result = null(seed, args.seconds, Path(folder) / f"null{seed}")
            p_values.append(result.p_value)
            names += bool(result.changes)
            print(f"null {seed}: p {result.p_value:.4f} {[it.effect for it in result.changes]}", flush=True)
        if p_values:
            print("p-values of nulls, quantiles 10, 25, 50, 75, 90 %:", end=" ")
            print(", ".join(f"{q:.2f}" for q in np.quantile(p_values, (0.1, 0.25, 0.5, 0.75, 0.9))))
            low = ", ".join(f"{np.mean(np.array(p_values) < at):.3f} below {at}" for at in (0.01, 0.05, 0.1))
            print(f"{low}; Kolmogorov-Smirnov p {kstest(p_values, 'uniform').pvalue:.2f}")
            print(f"names of changes that are none: {names} in {len(p_values)} pairs")
        for name in CHANGES:
            hits, right = 0, 0
            for seed in range(args.first, args.first + args.changes):
                hidden, result = changed(name, seed, args.seconds, Path(folder) / f"{name}{seed}")
                hits += result.has_changed
                first = result.changes[0] if result.changes else None
                right += first is not None and (first.effect, first.scope) == (hidden.name, hidden.scope)
                if not result.has_changed or first is None or first.effect != name:
                    told = [(it.effect, it.scope) for it in result.changes]
                    print(f"  {name} ({hidden.scope}), seed {seed}: p {result.p_value:.2g} {told}")
            print(f"{name}: changed {hits} of {args.changes}, named first {right}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
