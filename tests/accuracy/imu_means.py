"""Calibration of an IMU from means of poses, by the command line: coverage of the sigmas.

    python tests/accuracy/imu_means.py [--seeds 20] [--first 0]

The generator is `tests/generators/poses.py`. Coverage: share of errors within 1.96 of their sigma, with its
binomial 95 % interval. "plain" is an ordinary least-squares line of each axis, or eq. 6 of Avrutov.
"""

import json
import sys
import tempfile
from pathlib import Path

import numpy as np
from scipy.linalg import sqrtm
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from imu_records import coverage, draw_errors, rms, solve_once, triad_matrix

from generators.poses import GRAVITY
from hubodo.cli import main as hubodo
from script_arguments import script_parser

AXES = "xyz"
SIGMA = 3e-3
COUNT = 100


def means(rng, accel, poses):
    """Return means (R, 3) and gravity in node axes (R, 3) of a triad in random poses."""
    force = Rotation.random(poses, rng=rng).inv().apply([0.0, 0.0, GRAVITY])
    return accel.measure(force) + SIGMA * rng.standard_normal(force.shape), force


def write(path, columns):
    text = ",".join(["label", *columns]) + "\n"
    for k, row in enumerate(zip(*columns.values(), strict=True)):
        text += f"pose {k}," + ",".join(f"{value:.12g}" for value in row) + "\n"
    path.write_text(text)


def calibrate(folder, columns, *options):
    """Return the effects, or None if the calibration is refused."""
    write(folder / "means.csv", columns)
    out = folder / "out.json"
    arguments = ["calibrate", "imu", str(folder / "means.csv"), "--means", "--node", "imu", "--json"]
    arguments += ["-o", str(folder / "out.toml"), "--gravity", str(GRAVITY), *options]
    stdout, sys.stdout = sys.stdout, out.open("w")
    try:
        code = hubodo(arguments)
    finally:
        sys.stdout.close()
        sys.stdout = stdout
        (folder / "out.toml").unlink(missing_ok=True)
    return json.loads(out.read_text())["effects"] if code == 0 else None


def pulls_of(effects, bias, matrix):
    """Return errors in units of sigma, and the errors of the biases."""
    b, e = effects["accel_bias"], effects["accel_scale_factor"]
    error = [b[a]["value"] - bias[AXES.index(a)] for a in b]
    pulls = [x / b[a]["sigma"] for x, a in zip(error, b, strict=True)]
    pulls += [(e[a]["value"] - matrix[k, k] + 1) / e[a]["sigma"] for a in e for k in [AXES.index(a)]]
    return pulls, error


def gravity_trial(folder, rng, with_sigma, poses=24, knocked=False):
    accel = draw_errors(rng, 0.3)
    mean, _ = means(rng, accel, poses)
    if knocked:
        mean[7] *= 1.005
    columns = {"a" + axis: mean[:, k] for k, axis in enumerate(AXES)}
    if with_sigma == "columns":
        columns |= {"std_a" + axis: np.full(poses, SIGMA * np.sqrt(COUNT)) for axis in AXES}
        columns["count"] = np.full(poses, COUNT)
    options = ("--mean-sigma", f"accel={SIGMA}") if with_sigma == "option" else ()
    effects = calibrate(folder, columns, *options)
    matrix = triad_matrix(accel)
    plain = solve_once(mean / GRAVITY)[:3] - accel.b
    return effects and (*pulls_of(effects, accel.b, np.real(sqrtm(matrix @ matrix.T))), plain)


def reference_trial(folder, rng, axes, poses=12):
    accel = draw_errors(rng, 0.3, 0.01 if axes == AXES else 0.0)
    mean, force = means(rng, accel, poses)
    columns = {}
    for k, axis in enumerate(AXES):
        if axis in axes:
            columns |= {"a" + axis: mean[:, k], f"ref_a{axis} (g)": force[:, k] / 9.80665}
    effects = calibrate(folder, columns)
    plain = [
        np.polyfit(force[:, AXES.index(a)], mean[:, AXES.index(a)], 1)[1] - accel.b[AXES.index(a)]
        for a in axes
    ]
    return effects and (*pulls_of(effects, accel.b, triad_matrix(accel)), plain)


CASES = {
    "24 poses, noise unknown": lambda f, rng: gravity_trial(f, rng, ""),
    "24 poses, noise by --mean-sigma": lambda f, rng: gravity_trial(f, rng, "option"),
    "24 poses, std and count": lambda f, rng: gravity_trial(f, rng, "columns"),
    "12 poses, noise unknown": lambda f, rng: gravity_trial(f, rng, "", 12),
    "24 poses, one 5 mg off": lambda f, rng: gravity_trial(f, rng, "", knocked=True),
    "12 poses, references of three axes": lambda f, rng: reference_trial(f, rng, AXES),
    "12 poses, one axis with reference": lambda f, rng: reference_trial(f, rng, "z"),
    "6 poses, one axis with reference": lambda f, rng: reference_trial(f, rng, "x", 6),
}


def main():
    parser = script_parser(__doc__, seeds=20, first=0)
    args = parser.parse_args()
    print(f"means of poses, seeds {args.first} to {args.first + args.seeds - 1}: bias in m/s², rms")
    print(f"{'':36s} {'coverage':>20s} {'bias':>8s} {'plain':>8s}  refused")
    with tempfile.TemporaryDirectory() as name:
        for case, trial in CASES.items():
            seeds = range(args.first, args.first + args.seeds)
            rows = [trial(Path(name), np.random.default_rng([seed, 33])) for seed in seeds]
            done = [row for row in rows if row]
            pulls, error, plain = (np.concatenate([row[k] for row in done]) for k in range(3))
            print(
                f"{case:36s} {coverage(pulls)} {rms(error):8.1e} {rms(plain):8.1e}  {len(rows) - len(done)}",
                flush=True,
            )


if __name__ == "__main__":
    main()
