"""Writes one case: a CSV folder with model.toml, and hidden.json with what is hidden in it.

python tests/gap_matrix/make_case.py --effect wheel_camber --strength medium --seed 3 -o DIR
"""

# ruff: noqa: E402 (BLAS must know its threads before numpy is loaded)

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# The package is found from its parent; this folder itself must not stand on the path, or its names would.
sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

import numpy as np

from gap_matrix import cases, drives, effects, recording
from gap_matrix.dose import STRENGTHS, Meter


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

    names: none, one or more, each with its own dose
    strength: one of STRENGTHS, or nats
    factor: multiple of the typical size, instead of a strength
    rate_hz: of both nodes, default drawn

    Raises ValueError as `Meter.dose`.
    """
    setup = cases.setup(seed, kind, duration, known, vibration, speed_noise)
    if rate_hz is not None:
        setup = cases.sampled_at(setup, rate_hz, np.random.default_rng(seed))
    drawn = [cases.hidden_effect(setup, name, scope) for name in names]
    target = STRENGTHS[strength] if isinstance(strength, str) else strength
    meter = Meter(setup) if drawn else None
    hidden, gains = [], []
    for effect in drawn:
        made, gain = (
            meter.dose(effect, target)
            if factor is None
            else (effects.scaled(effect, factor), meter.gain(effects.scaled(effect, factor)))
        )
        hidden.append(made)
        gains.append(gain)
    truth = {
        "strength": strength if drawn and factor is None else None,
        "target_nats": target if drawn and factor is None else None,
        "gain_nats": gains,
        "kind": kind,
        "duration": setup.drive.duration,
        "known": [effect.name for effect in setup.known],
    }
    recording.write(setup, hidden, folder, truth)
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
    parser.add_argument("--nats", type=float, help="gain instead of a named strength")
    parser.add_argument("--factor", type=float, help="times the typical size, instead of a dose")
    parser.add_argument("--scope", help="left, right, all or vehicle; else drawn")
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--kind", default="drive", choices=drives.KINDS)
    parser.add_argument("--seconds", type=float, help="else drawn from 60, 120, 240")
    parser.add_argument(
        "--known", action="append", default=[], choices=cases.KNOWN, help="declared in model.toml"
    )
    parser.add_argument(
        "--vibration", type=float, help="growth of the accelerometer's noise per m/s; else drawn"
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
