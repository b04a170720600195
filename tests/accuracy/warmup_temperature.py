"""Bias against temperature by `warmup`: coverage of a polynomial's coefficients, and of the hysteresis.

    python tests/accuracy/warmup_temperature.py [--seeds 20] [--first 0]

Two hours in a chamber that swings by 15 °C, one and a half cycles, noise of 0.1 deg/s once a second. Columns:
orders of the accepted model (0 to 3); share of coefficients within 1.96 of their sigma with its binomial 95 %
interval; records in which hysteresis is named; rms error of the bias from 12 to 38 °C by the accepted model,
by a straight line ("plain") and by least squares of the true order in white noise ("bound"), deg/h.
"""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parent))

from imu_records import coverage, rms

from generators.warm_ups import NOISE, heat_cycle
from hubodo.errors import HubodoError
from hubodo.sensors.warmup.characterise import characterise_warmup
from script_arguments import script_parser

SECONDS, DEG = 7200, np.pi / 180.0
NAMES = ("temperature_coefficient", "temperature_quadratic", "temperature_cubic")
GRID = np.linspace(12.0, 38.0, 27) - 25.0
ROWS = [
    *((order, 0.0, added, 0.0) for order in (1, 2, 3) for added in ("", "flicker")),
    (2, 0.0, "random walk", 0.0),
    (2, 0.0, "", 0.1),
    (1, 0.05, "", 0.0),
    (2, 0.05, "flicker", 0.0),
]


def curve(coefficients):
    return sum((k * GRID ** (n + 1) for n, k in enumerate(coefficients)), np.zeros(len(GRID)))


def main():
    parser = script_parser(__doc__, seeds=20, first=0)
    args = parser.parse_args()
    seeds = range(args.first, args.first + args.seeds)
    print(f"seeds {seeds[0]} to {seeds[-1]}")
    head = f"{'deg/h':>7s} {'plain':>7s} {'bound':>6s} refused"
    print(f"{'':44s} {'orders':14s} {'coverage':>20s} hysteresis {head}")
    for order, hysteresis, added, warm in ROWS:
        pulls, orders, named, refused, errors, plain, bounds = [], [], 0, 0, [], [], []
        for seed in seeds:
            rng = np.random.default_rng([seed, order, len(added), round(100 * hysteresis)])
            t, bias, temperature, true = heat_cycle(SECONDS, order, rng, hysteresis, added, warm)
            output = (bias + rng.normal(0.0, NOISE, len(t))) * DEG
            try:
                result = characterise_warmup(t, output, "gz", temperature=temperature)
            except HubodoError:
                refused += 1
                continue
            named += result.hysteresis is not None
            values = result.values
            shown = [values.get(name, 0.0) / DEG for name in NAMES]
            orders.append(sum(name in values for name in NAMES))
            complete = np.pad(true, (0, 3 - order))
            pulls += [
                (shown[n] - complete[n]) / (result.sigma[name] / DEG)
                for n, name in enumerate(NAMES)
                if name in values
            ]
            errors.append(centred(curve(shown) - curve(true)))
            line = np.polyfit(temperature - 25.0, output / DEG, 1)
            plain.append(centred(line[0] * GRID - curve(true)))
            design = (temperature - 25.0)[:, None] ** np.arange(order + 1)
            powers = GRID[:, None] ** np.arange(1, order + 1)
            powers = powers - powers.mean(axis=0)
            covariance = NOISE**2 * np.linalg.inv(design.T @ design)[1:, 1:]
            bounds.append(np.sqrt(np.einsum("ni,ij,nj->n", powers, covariance, powers).mean()))
        name = f"order {order}{', hysteresis' if hysteresis else ''}{', ' + added if added else ''}"
        name += ", exponential" if warm else ""
        share = coverage(np.array(pulls)) if pulls else f"{'':20s}"
        print(
            f"{name:44s} {np.bincount(orders, minlength=4).tolist()!s:14s} {share} {named:10d} "
            f"{3600 * rms(errors):7.1f} {3600 * rms(plain):7.1f} {3600 * rms(bounds):6.1f} {refused:7d}",
            flush=True,
        )


def centred(values):
    """Return a curve without its mean, which the bias contains."""
    return values - values.mean()


if __name__ == "__main__":
    main()
