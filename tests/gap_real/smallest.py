"""Smallest size of each effect that a drive of a real car shows, by the gain that a known size has.

    python tests/gap_real/smallest.py [--pairs drive-1:drive-2] [--effects gyro_bias] [--models out/gap-real]

Each effect is injected into one node as in `real.py`, and the search judges it alone, with the model of the
other drive. The gain on held-out samples grows with the square of the size; the smallest size is that at
which it equals what `gap` demands of such an effect in such residuals.
"""

from __future__ import annotations

import argparse
import math
import sys
from dataclasses import dataclass
from pathlib import Path

sys.path[:0] = [str(Path(__file__).resolve().parents[1]), str(Path(__file__).resolve().parent)]

from car import DELAY_EFFECTS, read_drive  # noqa: E402
from real import DRIVES, Case, find_injection, list_cases  # noqa: E402

from hubodo.effects import BY_NAME  # noqa: E402
from hubodo.gap.judge.demands import MIN_CORRELATED_GAIN  # noqa: E402
from hubodo.gap.judge.hypothesis import Hypothesis  # noqa: E402
from hubodo.gap.judge.round import EMPIRICAL, judge_round  # noqa: E402
from hubodo.gap.judge.search import build_initial_state  # noqa: E402
from hubodo.gap.problem.build import build_problem  # noqa: E402
from hubodo.gap.refit.refit import refit_with_weights  # noqa: E402
from hubodo.model.model_file import read_model  # noqa: E402


@dataclass(frozen=True)
class Smallest:
    """Smallest size of one effect.

    size: share of the injected size, or of the fitted one of a delay, which includes that of the drive
    gain, demanded: on held-out samples, ln likelihood, of the injected size and of the smallest one
    """

    case: Case
    size: dict[str, float]
    gain: float
    demanded: float


def measure_smallest(case: Case, folder: Path, seed: int) -> Smallest | None:
    """Return the smallest size of the effect of a case; None if its likelihood is not that of the mean."""
    model = read_model(folder / f"{case.learnt_on}.toml")
    recording = read_drive(case.drive)
    injection = find_injection(case, recording, model)
    state = build_initial_state(build_problem(injection.apply(recording, case.node, seed), model))
    fit = refit_with_weights(state)
    judged = judge_round(fit.evaluation, {EMPIRICAL, *(name for name in BY_NAME if name != case.effect)})
    hypothesis = judged.find_hypothesis((case.effect, case.node))
    if hypothesis is None or hypothesis.held_out_gain is None:
        return None
    gain, demanded = hypothesis.held_out_total, demanded_gain(hypothesis, judged.tempering)
    share = math.sqrt(demanded / gain) if gain > 0.0 else math.inf
    # The gain does not grow with the time constant of a warm-up.
    size = {
        name: value
        for name, value in injection.parameters.items()
        if name != "time_constant" or case.effect == "gyro_lag"
    }
    if case.effect in DELAY_EFFECTS:
        size = {name: abs(hypothesis.term.effect.values()[name]) for name in size}
    return Smallest(case, {name: share * value for name, value in size.items()}, gain, demanded)


def demanded_gain(hypothesis: Hypothesis, tempering: float) -> float:
    """Return the gain on held-out samples below which a hypothesis has an objection, at most.

    Less suffices for one whose estimates from parts of the log agree.
    """
    chance = MIN_CORRELATED_GAIN * tempering
    doubt = hypothesis.doubtful_gain
    return min(chance, doubt) if hypothesis.term.effect.varies_between_drives else doubt


def main() -> int:
    """Print one row for each effect and drive."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--pairs", default=",".join(f"{a}:{b}" for a in DRIVES for b in DRIVES if a != b))
    parser.add_argument("--effects", default="", help="only these")
    parser.add_argument("--models", type=Path, default=Path("out/gap-real"), help="folder with DRIVE.toml")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    pairs = [(pair.split(":")[0], pair.split(":")[1]) for pair in options.pairs.split(",")]
    effects = [name for name in options.effects.split(",") if name]
    print(f"seed {options.seed}")
    for case in list_cases(pairs, effects, ("medium",)):
        row = measure_smallest(case, options.models, options.seed) if case.effect else None
        if row is not None:
            sizes = " ".join(f"{name} {value:.2g}" for name, value in row.size.items())
            print(
                f"{case.learnt_on} on {case.drive}, {case.effect:22} {case.node:5} {sizes:36} "
                f"gain {row.gain:.0f}, demanded {row.demanded:.0f}",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
