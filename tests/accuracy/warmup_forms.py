"""Consistency of a warm-up forecast's sigma for warm-ups of any form.

python tests/accuracy/warmup_forms.py [SEEDS]

An hour from power-on is recorded; the bias is forecast half an hour, one hour and three hours after its end.
"stated form": the forecast with the form stated as one or two exponentials, where that is true.
Columns: rms error in deg/h, and the share of errors within 1 and 2 of their sigma. "exponential at its word"
is the fit of eq. 1 of Barshan and Durrant-Whyte with the sigma that assumes this form; "last minutes" is the
baseline without a model: the mean of the last five minutes, held for ever.
"""

import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from generators import warm_ups
from hubodo.sensors.warmup.characterise import characterise_warmup

DEG = np.pi / 180.0
RECORD = 3600
AGES = np.array([RECORD // 2, RECORD + 3600, RECORD + 3 * 3600])
PLACES = ("inside", "1 h on", "3 h on")
HALF = 30
"""s; a bias is the mean over a minute."""


def one(form, added, seed, *, with_stated=False):
    """Return errors (3,) and sigmas (3,), deg/s, by method, of which one needs an accepted model."""
    rng = np.random.default_rng([seed, warm_ups.FORMS.index(form), warm_ups.ADDED.index(added)])
    t, bias, temperature = warm_ups.warm_up(form, added, AGES[-1] + HALF + 1, rng)
    current = slice(0, RECORD)
    output = (bias[current] + rng.normal(0.0, warm_ups.NOISE, RECORD)) * DEG
    warm = None if temperature is None else temperature[current]
    report = characterise_warmup(t[current], output, "gz", temperature=warm)
    stated = {"one exponential": "exponential"}.get(form, form if form == "two exponentials" else None)
    later = None if temperature is None else temperature[AGES]
    truth = np.array([bias[a - HALF : a + HALF].mean() for a in AGES])
    mean, sigma = report.forecast.predict(AGES.astype(float), later)
    produced = {"forecast": (mean / DEG - truth, sigma / DEG)}
    if with_stated and stated is not None:
        believed = characterise_warmup(t[current], output, "gz", form=stated)
        mean, sigma = believed.forecast.predict(AGES.astype(float))
        produced["stated form"] = (mean / DEG - truth, sigma / DEG)
    if report.accepted is not None:
        fit = report.accepted.fit
        value = fit.model.bias(AGES.astype(float), later)
        error = report.forecast.model_error(AGES.astype(float), value, later)
        produced["accepted model"] = (value / DEG - truth, error / DEG)
        produced["file"] = (value / DEG - truth, in_file(fit, report.sigma, later) / DEG)
    fit = report.exponential.fit
    word = fit.model.bias(AGES.astype(float))
    produced["exponential at its word"] = (word / DEG - truth, fit.bias_sigma(AGES.astype(float)) / DEG)
    last = output[-300:].mean() / DEG
    produced["last minutes"] = (last - truth, np.full(3, warm_ups.NOISE / np.sqrt(300.0)))
    return produced


def in_file(fit, sigma, temperature):
    """Return the forecast computed from the file alone, without correlations."""
    total = np.full(len(AGES), sigma["c2"] ** 2)
    for which in ("", "_second"):
        if f"c1{which}" in sigma:
            c1, constant = fit.values[f"c1{which}"], fit.values[f"time_constant{which}"]
            left = np.exp(-AGES / constant)
            total += ((1.0 - left) * sigma[f"c1{which}"]) ** 2
            total += (c1 * AGES / constant**2 * left * sigma[f"time_constant{which}"]) ** 2
    if "temperature_coefficient" in sigma:
        total += ((temperature - 25.0) * sigma["temperature_coefficient"]) ** 2
    return np.sqrt(total)


def ensemble(form, added, seeds, *, with_stated=False):
    """Return errors and sigmas by method, (M, 3) each."""
    rows = [one(form, added, seed, with_stated=with_stated) for seed in seeds]
    ways = dict.fromkeys(distance for row in rows for distance in row)
    return {
        distance: tuple(np.array([row[distance][k] for row in rows if distance in row]) for k in (0, 1))
        for distance in ways
    }


def main(argv=None):
    arguments = sys.argv[1:] if argv is None else argv
    seeds = range(int(arguments[0]) if arguments else 20)
    began = time.monotonic()
    print(__doc__.split("\n\n")[2])
    print(f"\n{'':42}" + "".join(f"{place:>25}" for place in PLACES))
    print(f"{'':42}" + f"{'deg/h':>11}{'1 sig':>7}{'2 sig':>7}" * 3)
    pulls = {
        distance: []
        for distance in (
            "forecast",
            "stated form",
            "accepted model",
            "file",
            "exponential at its word",
            "last minutes",
        )
    }
    for form in warm_ups.FORMS:
        for added in warm_ups.ADDED:
            output = ensemble(form, added, seeds, with_stated=True)
            print(f"{form}{', ' + added if added else ''}")
            for distance in pulls:
                if distance not in output:
                    continue
                error, sigma = output[distance]
                pulls[distance].append(np.abs(error / sigma))
                print(f"  {f'{distance} ({len(error)})':40}", end="")
                for k in range(3):
                    rms = 3600.0 * np.sqrt(np.mean(error[:, k] ** 2))
                    pull = pulls[distance][-1][:, k]
                    print(f"{rms:>11.1f}{np.mean(pull < 1):>7.2f}{np.mean(pull < 2):>7.2f}", end="")
                print(flush=True)
    print("all together, share within 1 and 2 sigma, and rms of error / sigma (1 is true):")
    good = True
    for distance, parts in pulls.items():
        pull = np.concatenate(parts)
        within = " ".join(f"{np.mean(pull[:, k] < 1):.2f} {np.mean(pull[:, k] < 2):.2f}" for k in range(3))
        print(f"  {distance:30}{within}   rms {np.sqrt(np.mean(pull**2, axis=0)).round(2)}")
        if distance in ("forecast", "file"):
            good &= bool(np.all(np.mean(pull < 2, axis=0) > 0.9))
    print(f"seeds {seeds.start}..{seeds.stop - 1}; {time.monotonic() - began:.0f} s")
    print(
        "claim: nine of ten errors of the forecast and of the file within 2 sigma:",
        "met" if good else "NOT met",
    )
    return not good


if __name__ == "__main__":
    sys.exit(main())
