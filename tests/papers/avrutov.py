"""Avrutov 2010 beside our results: the test case, Figure 2 with its knee at eight decimals, averaging.

.venv/bin/python tests/papers/avrutov.py [--seed N] [--png FILE]
"""

import argparse
import itertools
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from scipy.spatial.transform import Rotation

from generators.poses import Errors
from hubodo.errors import CalibrationError
from hubodo.sensors.imu.scalar_calibration import fit_scalar_calibration

TRUTH = Errors(
    (2e-4, 2e-4, 2e-4),
    (2e-4, 4e-4, 4e-4),
    {"xz": 2e-4, "yz": -2e-4, "zy": 2e-4, "xy": -2e-4, "yx": 2e-4, "zx": -2e-4},
)
ALPHA, BETA, GAMMA = np.arange(0, 360, 40), np.arange(0, 81, 10), np.arange(0, 360, 40)
DECIMALS = range(2, 13)
ORDERS = ["".join(p) for p in itertools.permutations("XYZ")]
WORKS = 5.0
"""%; a bias known to this counts as found.

Figure 2 has no scale, the paper says only from where it "works".
"""
NOISE_LSB = 3.0
AVERAGES = (1, 100, 10_000)


def gravity(order, every_combination=False):
    """Return unit vectors of gravity (0, 0, -g) in the node for the angles of the paper, (R, 3)."""
    combine = itertools.product if every_combination else zip
    angles = np.radians(np.array(list(combine(ALPHA, BETA, GAMMA)), float))
    return Rotation.from_euler(order, angles).inv().apply([0.0, 0.0, -1.0])


def as_in_the_paper(u, g):
    """Return the errors by eq. 6: one linear solution with the true direction cosines."""
    x, y, z = g.T
    rows = np.column_stack([x, y, z, x * x, y * y, z * z, x * y, x * z, y * z])
    return np.linalg.lstsq(rows, ((u**2).sum(axis=1) - 1) / 2, rcond=None)[0], np.linalg.cond(rows)


def worst_bias_error(p):
    """Return the largest relative error of the three biases, %, the quantity of Figure 2."""
    return 100 * float(np.abs(p[:3] / np.array(TRUTH.b) - 1).max())


def ours(u, sigma):
    try:
        return worst_bias_error(fit_scalar_calibration(u, 1.0, np.full(u.shape, sigma)).parameters)
    except CalibrationError:
        return None


def knee(errors):
    """Return the first number of decimals from which on the error stays below WORKS."""
    for d in DECIMALS:
        if all(errors[k] is not None and errors[k] < WORKS for k in DECIMALS if k >= d):
            return d
    return None


def show(label, errors):
    cells = " ".join("refused" if errors[d] is None else f"{errors[d]:7.2g}" for d in DECIMALS)
    print(f"{label:34s} {cells}   {knee(errors) or '-'}")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--png", type=Path)
    args = parser.parse_args()
    rng = np.random.default_rng(args.seed)
    print(f"Avrutov 2010, largest relative error of the three biases in %, seed {args.seed}")
    print(f"{'decimals':34s} " + " ".join(f"{d:7d}" for d in DECIMALS) + "   knee")
    print("paper, Figure 2 (scale lost)" + " " * 97 + "   8")
    curves = {}
    for order in ORDERS:
        g = gravity(order)
        u = TRUTH.measure(g)
        errors = {d: worst_bias_error(as_in_the_paper(np.round(u, d), g)[0]) for d in DECIMALS}
        condition = as_in_the_paper(u, g)[1]
        show(f"eq. 6, 9 poses, {order}, cond {condition:.2g}", errors)
        if order == "ZYX":
            curves["eq. 6 as in the paper, 9 poses"] = errors
    g = gravity("ZYX")
    u = TRUTH.measure(g)
    errors = {d: ours(np.round(u, d), 10.0**-d / np.sqrt(12)) for d in DECIMALS}
    show("ours, 9 poses, ZYX", errors)
    curves["ours, 9 poses"] = errors
    g = gravity("ZYX", every_combination=True)
    u = TRUTH.measure(g)
    show(
        "eq. 6, 729 poses, ZYX",
        {d: worst_bias_error(as_in_the_paper(np.round(u, d), g)[0]) for d in DECIMALS},
    )
    errors = {d: ours(np.round(u, d), 10.0**-d / np.sqrt(12)) for d in DECIMALS}
    show("ours, 729 poses, ZYX", errors)
    curves["ours, 729 poses"] = errors
    g = gravity("ZYX")
    u = TRUTH.measure(g)
    print(
        f"averaging, with white noise of {NOISE_LSB:.0f} of the last digit before rounding (median of 9 "
        f"runs):"
    )
    for count in AVERAGES:
        errors = {}
        for d in DECIMALS:
            result = []
            for _ in range(9):
                noise = NOISE_LSB * 10.0**-d * rng.standard_normal((count, *u.shape))
                mean = np.round(u + noise, d).mean(axis=0)
                result.append(ours(mean, NOISE_LSB * 10.0**-d / np.sqrt(count)))
            good = [e for e in result if e is not None]
            errors[d] = float(np.median(good)) if len(good) > 4 else None
        show(f"ours, 9 poses, {count} averaged", errors)
        curves[f"ours, {count} averaged"] = errors
    p = fit_scalar_calibration(TRUTH.measure(gravity("ZYX", True)), 1.0, np.full((729, 3), 1e-9)).triad
    print(
        "six single angles by the symmetric convention: "
        + ", ".join(f"{name} {angle:+.9f}" for name, angle in p.nonorthogonality.items())
    )
    print(
        "The knee at eight is the condition number of the nine poses, not the method: all 729 poses move it "
        "to "
        f"{knee(curves['ours, 729 poses'])}, and 100 times the averaging moves it by one decimal. The "
        f"paper's curve is "
        "level beyond it because eq. 3 drops products of errors; solved again about each solution, ours "
        "goes on falling."
    )
    if args.png:
        draw(curves, args.png)


def draw(curves, path):
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(7, 4.5))
    for name, errors in curves.items():
        known = [(d, e) for d, e in errors.items() if e is not None]
        axes.semilogy(*zip(*known, strict=True), marker="o", label=name)
    axes.set(xlabel="decimals of the outputs", ylabel="relative error of bias, %")
    axes.legend(fontsize=8)
    axes.grid(alpha=0.3)
    figure.savefig(path, dpi=150, bbox_inches="tight")


if __name__ == "__main__":
    main()
