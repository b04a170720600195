"""Noise terms of independently simulated electronics over many seeds: errors and consistency of sigma.

    python tests/accuracy/allan_truth.py [SEEDS]

Printed for each term: the number of records in which it was claimed; mean error, rms error and reported sigma
in these; the number whose truth lies within one and within two sigma; and the number of the other records
whose truth is below the stated limit. A term that is not present must not be claimed. The bound is
Whittle's, of the record without electronics: a record of length T holds T df independent exponential values
of its spectrum S(f), so the information on log-parameters is T times the integral of dlnS dlnS df. No
unbiased estimator does better.
"""

import sys
import time
from functools import partial
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from generators.noise import bartlett, gyro_noise, one_pole, relaxing, two_pole
from hubodo.sensors.allan.characterise import characterise_noise

HZ = 100.0
LONG, MIDDLE, SHORT = 1 << 20, 1 << 18, 1 << 15
MEMS = {"n": 1e-3, "b": 3e-4, "k": 6e-5}
RECORDS = {
    "white noise": (MIDDLE, {"n": 1e-3}, []),
    "one pole at 40 Hz": (MIDDLE, {"n": 1e-3}, [partial(one_pole, dt=1 / HZ, corner=40.0)]),
    "one pole at 20 Hz": (MIDDLE, {"n": 1e-3}, [partial(one_pole, dt=1 / HZ, corner=20.0)]),
    "one pole at 5 Hz": (MIDDLE, {"n": 1e-3}, [partial(one_pole, dt=1 / HZ, corner=5.0)]),
    "two poles at 30 Hz": (MIDDLE, {"n": 1e-3}, [partial(two_pole, dt=1 / HZ, corner=30.0)]),
    "a window of 15 taps": (MIDDLE, {"n": 1e-3}, [partial(bartlett, taps=8)]),
    "all terms plain in 2.9 h": (LONG, {"q": 1e-4, "n": 1e-3, "b": 4e-3, "k": 8e-3}, []),
    "a MEMS gyro of 20 Hz, 44 min": (MIDDLE, MEMS, [partial(one_pole, dt=1 / HZ, corner=20.0)]),
    "relaxations for flicker, 40 Hz": (MIDDLE, MEMS, ["relaxing", partial(one_pole, dt=1 / HZ, corner=40.0)]),
    "a MEMS gyro, walk only just, 2.9 h": (LONG, {"n": 1e-3, "b": 3e-3, "k": 6e-4}, []),
    "flicker too faint to claim": (MIDDLE, {"n": 1e-3, "b": 1e-4}, ["relaxing"]),
    "a walk about to be claimed, 5 min": (SHORT, {"n": 1e-3, "k": 4.5e-5}, []),
    "5 min behind 20 Hz": (SHORT, {"n": 1e-3, "b": 5e-4}, [partial(one_pole, dt=1 / HZ, corner=20.0)]),
    "a ramp of 4 mrad/s an hour": (MIDDLE, {"n": 1e-3, "b": 1e-4, "r": 1e-6}, []),
    "steps of one sigma": (MIDDLE, {"n": 1e-3}, [lambda x: np.rint(x / 0.01) * 0.01]),
}
STEPS = 0.01**2 / 12.0 / HZ
"""Return the increase of N², rad²/s, by rounding to steps of 0.01 rad/s."""


def bounds(samples, truth):
    """Return the relative 1 sigma of each noise term by Whittle's information matrix."""
    dt = 1.0 / HZ
    f = np.geomspace(0.5 / (samples * dt), 0.5 / dt, 20_000)
    shapes = {
        "q": 8.0 * np.sin(np.pi * f * dt) ** 2 / dt,
        "n": np.full_like(f, 2.0),
        "b": 1.0 / (np.pi * f),
        "k": 2.0 * (dt / (2.0 * np.sin(np.pi * f * dt))) ** 2,
    }
    names = [name for name in truth if name != "r"]
    parts = np.array([truth[name] ** 2 * shapes[name] for name in names])
    slopes = 2.0 * parts / parts.sum(axis=0)
    information = samples * dt * np.trapezoid(slopes[:, None] * slopes[None, :], f)
    return dict(zip(names, np.sqrt(np.diag(np.linalg.inv(information))), strict=True))


def simulate_rates(title, samples, truth, electronics, seed):
    """Return simulated rates, (samples,), and the true noise terms."""
    rng = np.random.default_rng([seed, list(RECORDS).index(title), 952])
    terms = dict(truth)
    slow = relaxing(samples, 1.0 / HZ, rng, terms.pop("b")) if "relaxing" in electronics else 0.0
    rates = gyro_noise(samples, 1.0 / HZ, rng, **terms) + slow
    for part in electronics:
        rates = rates if part == "relaxing" else part(rates)
    if title == "steps of one sigma":
        truth = {"n": float(np.sqrt(truth["n"] ** 2 + STEPS))}
    return rates, truth


def main(argv=None):
    arguments = sys.argv[1:] if argv is None else argv
    seeds = int(arguments[0]) if arguments else 40
    began = time.monotonic()
    sums = {"inside": 0, "claimed": 0, "below": 0, "limits": 0, "false": 0, "absent": 0}
    print(f"seeds 0 to {seeds - 1}; {HZ:g} Hz; {SHORT}, {MIDDLE} or {LONG} samples")
    for title, (samples, truth, electronics) in RECORDS.items():
        result = {name: [] for name in "QNBKR"}
        for seed in range(seeds):
            rates, true = simulate_rates(title, samples, truth, electronics, seed)
            terms = characterise_noise(np.arange(samples) / HZ, rates, "gz").fit.terms
            for name, term in terms.items():
                result[name].append(term)
        print(
            f"{title}\n{'':8}truth  claimed    mean     rms    said   bound  in 1 σ  in 2 σ  below its limit"
        )
        low = bounds(samples, true)
        for name, terms in result.items():
            print_term(name, terms, true.get(name.lower(), 0.0), low.get(name.lower()), sums)
    print(
        f"{time.monotonic() - began:.0f} s. "
        f"Claimed and true: within 2 sigma {sums['inside']} of {sums['claimed']}. "
        f"Not claimed but there: below the limit of 95 % {sums['below']} of {sums['limits']}. "
        f"Claimed but not there: {sums['false']} of {sums['absent']}."
    )
    held = sums["inside"] > 0.9 * sums["claimed"] and sums["below"] > 0.9 * sums["limits"]
    return not (held and sums["false"] < 0.01 * sums["absent"])


def print_term(name, terms, true, bound, sums):
    """Print a line for a term that is present, or falsely detected, and add it to the sums."""
    claimed = [term for term in terms if term.value is not None]
    limits = [term.limit for term in terms if term.value is None and term.limit is not None]
    if not true:
        sums["absent"] += len(terms)
        sums["false"] += len(claimed)
        if claimed:
            print(f"  {name}  absent {len(claimed):>5}/{len(terms)}")
        return
    words = f"  {name}{true:>10.3g}{f'{len(claimed)}/{len(terms)}':>9}"
    if claimed:
        errors = np.array([term.value / true - 1.0 for term in claimed])
        messages = np.array([term.sigma / true for term in claimed])
        inside = [np.mean(np.abs(errors) < n * messages) for n in (1, 2)]
        sums["inside"] += int(np.sum(np.abs(errors) < 2 * messages))
        sums["claimed"] += len(claimed)
        for share in (errors.mean(), np.sqrt(np.mean(errors**2)), np.median(messages)):
            words += f"{100 * share:>7.2f}%"
        words += f"{'':>8}" if bound is None else f"{100 * bound:>7.2f}%"
        words += f"{100 * inside[0]:>7.0f}%{100 * inside[1]:>7.0f}%"
    if limits:
        below = sum(true < most for most in limits)
        sums["below"] += below
        sums["limits"] += len(limits)
        words += f"{'':{max(1, 76 - len(words))}}{below}/{len(limits)}"
    print(words)


if __name__ == "__main__":
    sys.exit(main())
