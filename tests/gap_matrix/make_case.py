"""Write one case: a CSV folder with model.toml, and hidden.json with the hidden effects.

python tests/gap_matrix/make_case.py --effect wheel_camber --strength medium --seed 3 -o DIR
"""

# ruff: noqa: E402 (the number of BLAS threads is set before numpy is imported)

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# gap_matrix is imported from its parent folder; with this folder on the path, its modules would shadow
# others.
sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

import numpy as np

from gap_matrix import cases, drives, effects, recording
from gap_matrix.dose import STRENGTHS, GainMeter


def write_case(
    folder: Path,
    seed: int,
    names: Sequence[str],
    strength: str | float = "medium",
    *,
    factor: float | None = None,
    scope: str | None = None,
    kind: str = "drive",
    duration: float | None = None,
    known: Sequence[str] = (),
    vibration: float | None = None,
    speed_noise: float = 0.0005,
    rate_hz: float | None = None,
) -> list[effects.Effect]:
    """Write a case and return the hidden effects.

    names: hidden effects, possibly none, each scaled to the strength
    strength: one of STRENGTHS, or a gain in nats
    factor: multiple of the typical size, instead of a strength
    scope: of each effect, default drawn
    kind: one of drives.KINDS
    rate_hz: sample rate of both nodes, default drawn
    For the other parameters see `cases.draw_setup`.

    Raises ValueError if the drive shows too little of an effect.
    """
    setup = cases.draw_setup(seed, kind, duration, known, vibration, speed_noise)
    if rate_hz is not None:
        setup = cases.resample_nodes(setup, rate_hz, np.random.default_rng(seed))
    drawn_effects = [cases.draw_hidden_effect(setup, name, scope) for name in names]
    target = STRENGTHS[strength] if isinstance(strength, str) else strength
    meter = GainMeter(setup) if drawn_effects else None
    hidden, gains = [], []
    for effect in drawn_effects:
        scaled_effect, gain = (
            meter.scale_to_gain(effect, target)
            if factor is None
            else (effects.scale_effect(effect, factor), meter.gain(effects.scale_effect(effect, factor)))
        )
        hidden.append(scaled_effect)
        gains.append(gain)
    truth = {
        "strength": strength if drawn_effects and factor is None else None,
        "target_nats": target if drawn_effects and factor is None else None,
        "gain_nats": gains,
        "kind": kind,
        "duration": setup.drive.duration,
        "known": [effect.name for effect in setup.known],
    }
    recording.write_case_files(setup, hidden, folder, truth)
    return hidden


def main() -> int:
    """Write a case and print the hidden effects."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--effect", action="append", required=True, choices=[*effects.KINDS, "none"], metavar="NAME"
    )
    parser.add_argument("--strength", default="medium", choices=list(STRENGTHS))
    parser.add_argument("--nats", type=float, help="gain, instead of a named strength")
    parser.add_argument("--factor", type=float, help="multiple of the typical size, instead of a strength")
    parser.add_argument("--scope", help="left, right, all or vehicle; default drawn")
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--kind", default="drive", choices=drives.KINDS)
    parser.add_argument("--seconds", type=float, help="default drawn from 60, 120, 240")
    parser.add_argument(
        "--known",
        action="append",
        default=[],
        choices=cases.DECLARABLE_EFFECTS,
        help="declared in model.toml",
    )
    parser.add_argument(
        "--vibration", type=float, help="relative growth of the accelerometer noise per m/s; default drawn"
    )
    parser.add_argument("-o", dest="folder", type=Path, required=True)
    args = parser.parse_args()
    try:
        hidden = write_case(
            args.folder,
            args.seed,
            [name for name in args.effect if name != "none"],
            args.nats or args.strength,
            factor=args.factor,
            scope=args.scope,
            kind=args.kind,
            duration=args.seconds,
            known=args.known,
            vibration=args.vibration,
        )
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    for effect in hidden:
        numbers = ", ".join(f"{key} {value:.4g}" for key, value in effect.parameters.items())
        print(f"{effect.name} ({effect.scope}): {numbers}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
