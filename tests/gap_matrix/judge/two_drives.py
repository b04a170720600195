"""Two drives of one vehicle: results of `gap --before --after` with and without a change.

    python tests/gap_matrix/judge/two_drives.py [--nulls 60] [--changes 10] [--first 0] [--seconds 90]

The p-values of pairs without a change should be uniform: their quantiles and a Kolmogorov-Smirnov test are
printed. Then a strong effect is added in the second drive, and the number of correct names is printed.
"""

# ruff: noqa: E402 (the number of BLAS threads is set before numpy is imported)

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# gap_matrix is imported from the folder above it; with its own folder on the path, its modules shadow others.
sys.path[:0] = [str(Path(__file__).resolve().parents[2])]

import tempfile

import numpy as np
from scipy.stats import kstest

from gap_matrix import cases, recording
from gap_matrix.cases import Setup
from gap_matrix.dose import STRENGTHS, GainMeter
from gap_matrix.effects import SIDES, Effect
from hubodo.gap.change.change import find_change
from hubodo.gap.change.result import ChangeResult
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model

# Hidden in both drives of every second pair, as an effect that does not change.
UNCHANGED_EFFECT = "lever_arm"
# A displaced sensor, a worn tyre, a tilted node, a bent wheel, a changed gyro.
CHANGED_EFFECTS = ("lever_arm", "wheel_radius", "node_misalignment", "wheel_camber", "gyro_scale_factor")
_SECOND_SEED_OFFSET = 100_000


def draw_two_setups(seed: int, duration: float, rate_hz: float | None = None) -> tuple[Setup, Setup]:
    """Return the setups of one vehicle on two drives.

    rate_hz: sample rate of all nodes, default drawn
    """
    first_setup, other_drive = (
        cases.draw_setup(seed, duration=duration),
        cases.draw_setup(_SECOND_SEED_OFFSET + seed, duration=duration),
    )
    noise = {
        side: replace(
            other_drive.noise[side],
            gyro=first_setup.noise[side].gyro,
            accel=first_setup.noise[side].accel,
            vibration=first_setup.noise[side].vibration,
        )
        for side in SIDES
    }
    second_setup = replace(
        other_drive,
        radius=first_setup.radius,
        track=first_setup.track,
        facing=first_setup.facing,
        noise=noise,
    )
    if rate_hz is None:
        return first_setup, second_setup
    rng = np.random.default_rng(seed)
    return cases.resample_nodes(first_setup, rate_hz, rng), cases.resample_nodes(second_setup, rate_hz, rng)


def compare_drives(
    setups: Sequence[Setup], before: Sequence[Effect], after: Sequence[Effect], folder: Path
) -> ChangeResult:
    """Write two drives with these hidden effects and return their comparison."""
    for setup, hidden, name in zip(setups, (before, after), ("before", "after"), strict=True):
        recording.write_case_files(setup, hidden, folder / name, {})
    logs = [read_folder(folder / name) for name in ("before", "after")]
    return find_change(*logs, read_model(folder / "before" / "model.toml"))


def compare_unchanged(seed: int, duration: float, folder: Path, rate_hz: float | None = None) -> ChangeResult:
    """Compare two drives without a change."""
    setups = draw_two_setups(seed, duration, rate_hz)
    unchanged_effects = []
    if seed % 2:
        effect = cases.draw_hidden_effect(setups[0], UNCHANGED_EFFECT)
        unchanged_effects = [GainMeter(setups[0]).scale_to_gain(effect, STRENGTHS["strong"])[0]]
    return compare_drives(setups, unchanged_effects, unchanged_effects, folder)


def compare_changed(
    name: str, seed: int, duration: float, folder: Path, rate_hz: float | None = None
) -> tuple[Effect, ChangeResult]:
    """Compare two drives with one more effect in the second."""
    setups = draw_two_setups(seed, duration, rate_hz)
    hidden = GainMeter(setups[1]).scale_to_gain(
        cases.draw_hidden_effect(setups[1], name), STRENGTHS["strong"]
    )[0]
    return hidden, compare_drives(setups, [], [hidden], folder)


def main() -> int:
    """Print both tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--nulls", type=int, default=60)
    parser.add_argument("--changes", type=int, default=4, help="pairs of each changed effect")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--seconds", type=float, default=90.0)
    args = parser.parse_args()
    p_values, n_false = [], 0
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(args.first, args.first + args.nulls):
            result = compare_unchanged(seed, args.seconds, Path(folder) / f"null{seed}")
            p_values.append(result.p_value)
            n_false += bool(result.changes)
            print(f"null {seed}: p {result.p_value:.4f} {[it.effect for it in result.changes]}", flush=True)
        if p_values:
            print("p-values of nulls, quantiles 10, 25, 50, 75, 90 %:", end=" ")
            print(
                ", ".join(
                    f"{quantile:.2f}" for quantile in np.quantile(p_values, (0.1, 0.25, 0.5, 0.75, 0.9))
                )
            )
            low_shares = ", ".join(
                f"{np.mean(np.array(p_values) < threshold):.3f} below {threshold}"
                for threshold in (0.01, 0.05, 0.1)
            )
            print(f"{low_shares}; Kolmogorov-Smirnov p {kstest(p_values, 'uniform').pvalue:.2f}")
            print(f"false names: {n_false} in {len(p_values)} pairs without a change")
        for name in CHANGED_EFFECTS:
            n_detected, n_correct = 0, 0
            for seed in range(args.first, args.first + args.changes):
                hidden, result = compare_changed(name, seed, args.seconds, Path(folder) / f"{name}{seed}")
                n_detected += result.has_changed
                first_change = result.changes[0] if result.changes else None
                n_correct += first_change is not None and (first_change.effect, first_change.scope) == (
                    hidden.name,
                    hidden.scope,
                )
                if not result.has_changed or first_change is None or first_change.effect != name:
                    changes = [(it.effect, it.scope) for it in result.changes]
                    print(f"  {name} ({hidden.scope}), seed {seed}: p {result.p_value:.2g} {changes}")
            print(f"{name}: changed {n_detected} of {args.changes}, named first {n_correct}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
