"""Known noise terms over 50 seeds: N and K to come back within 5 %, B within 20 %, beside the bound.

    python tests/accuracy/allan_truth.py [SEEDS]

The bound is Whittle's: a record of length T holds T df independent exponential values of its spectrum S(f),
so the information on log-parameters is T times the integral of dlnS dlnS df. No estimator without bias does
better.
"""

import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from generators.noise import gyro_noise
from hubodo.sensors.allan.characterise import characterise

DT, SAMPLES = 0.01, 1 << 20
CLAIMS = {"N": 0.05, "K": 0.05, "B": 0.20}
RECORDS = {
    "all terms plain in 2.9 h": {"q": 1e-4, "n": 1e-3, "b": 4e-3, "k": 8e-3},
    "without quantisation": {"n": 1e-3, "b": 6e-3, "k": 1e-2},
    "a MEMS gyro, walk only just in 2.9 h": {"n": 1e-3, "b": 3e-3, "k": 6e-4},
    "a ramp of 2 mrad/s an hour, no walk": {"n": 5e-4, "b": 3e-4, "r": 5.6e-7},
}


def bounds(truth):
    """Relative 1 sigma of each term by Whittle's information, quantisation, white, flicker and walk."""
    f = np.geomspace(0.5 / (SAMPLES * DT), 0.5 / DT, 20_000)
    shapes = {
        "q": 8.0 * np.sin(np.pi * f * DT) ** 2 / DT,
        "n": np.full_like(f, 2.0),
        "b": 1.0 / (np.pi * f),
        "k": 2.0 * (DT / (2.0 * np.sin(np.pi * f * DT))) ** 2,
    }
    names = [name for name in truth if name != "r"]
    parts = np.array([truth[name] ** 2 * shapes[name] for name in names])
    slopes = 2.0 * parts / parts.sum(axis=0)
    information = SAMPLES * DT * np.trapezoid(slopes[:, None] * slopes[None, :], f)
    return dict(zip(names, np.sqrt(np.diag(np.linalg.inv(information))), strict=True))


def main(argv=None):
    arguments = sys.argv[1:] if argv is None else argv
    seeds = int(arguments[0]) if arguments else 50
    began = time.monotonic()
    missed = []
    t = np.arange(SAMPLES) * DT
    for title, truth in RECORDS.items():
        errors = {name: [] for name in truth}
        covered = dict.fromkeys(truth, 0)
        for seed in range(seeds):
            noise = gyro_noise(SAMPLES, DT, np.random.default_rng([seed, 952]), **truth)
            terms = characterise(t, noise, "gz").fit.terms
            for name, true in truth.items():
                term = terms[name.upper()]
                if term.value is not None:
                    errors[name].append(term.value / true - 1)
                    covered[name] += abs(term.value - true) < 2 * term.sigma
        bound = bounds(truth)
        print(f"{title}: {seeds} seeds, {SAMPLES} samples at {1 / DT:g} Hz")
        print(
            f"{'':6}{'truth':>10}{'shown':>7}{'median':>9}{'rms':>8}"
            f"{'largest':>9}{'bound':>8}{'claim':>7}{'in 2 σ':>8}"
        )
        for name, true in truth.items():
            found = np.abs(errors[name])
            claim = CLAIMS.get(name.upper())
            low = bound.get(name)
            words = [
                f"{len(found)}/{seeds}",
                *(f"{100 * x:.2f} %" for x in (np.median(found), np.sqrt(np.mean(found**2)), found.max())),
                "" if low is None else f"{100 * low:.2f} %",
                "" if claim is None else f"{100 * claim:.0f} %",
                f"{100 * covered[name] / max(1, len(found)):.0f} %",
            ]
            print(
                f"  {name.upper():4}{true:>10.3g}"
                + "".join(f"{w:>{n}}" for w, n in zip(words, (7, 9, 8, 9, 8, 7, 8), strict=True))
            )
            # Where three sigma of the bound itself exceed the claim, no estimator keeps it on every seed.
            attainable = low is not None and claim is not None and 3 * low < claim
            if attainable and (found.max() > claim or len(found) < seeds):
                missed.append(f"{name.upper()} of {title}")
    print(
        f"{time.monotonic() - began:.0f} s; claims on every seed where 3 sigma of the bound allow it: "
        f"{missed or 'met'}"
    )
    return bool(missed)


if __name__ == "__main__":
    sys.exit(main())
