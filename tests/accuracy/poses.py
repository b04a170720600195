"""Calibration of an IMU laid down by hand in arbitrary poses: errors and consistency of sigmas.

    python tests/accuracy/poses.py [--seeds 60] [--first 0]

Errors of both triads are drawn for each seed (bias 0.3 m/s² and 0.02 rad/s, scale and angles 1 %). For
every parameter that a set of poses shows, the error in units of its sigma; beside it the trivial baseline, a
node that nobody calibrates.
"""

import sys
from pathlib import Path

import numpy as np
from scipy.linalg import sqrtm
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from generators.poses import GRAVITY, Errors, carry, laid_on_faces
from hubodo.errors import CalibrationError
from hubodo.sensors.imu.calibrate import calibrate_imu
from script_arguments import script_parser

POSES = {
    "six faces, exact": lambda rng: laid_on_faces(rng, 0.0),
    "six faces within 0.3 degrees": lambda rng: laid_on_faces(rng, 0.3),
    "six faces within 0.3 degrees, twice": lambda rng: laid_on_faces(rng, 0.3, times=2),
    "six faces within 5 degrees": lambda rng: laid_on_faces(rng, 5.0),
    "9 by hand": lambda rng: Rotation.random(9, rng=rng),
    "12 by hand": lambda rng: Rotation.random(12, rng=rng),
    "24 by hand": lambda rng: Rotation.random(24, rng=rng),
}
KINDS = {"bias": range(3), "scale": (3, 7, 11), "angles": (4, 5, 6, 8, 9, 10)}


def draw_errors(rng, bias):
    """Return errors of one triad, 1 % of scale and angles."""
    names = ("xz", "xy", "yz", "yx", "zy", "zx")
    angles = {name: 0.01 * rng.standard_normal() for name in names}
    return Errors(tuple(bias * rng.standard_normal(3)), tuple(0.01 * rng.standard_normal(3)), angles)


def triad_matrix(errors):
    """Return the (3, 3) matrix of a triad, from its measurements of unit vectors."""
    return errors.measure(np.eye(3)).T - np.array(errors.b)[:, None]


def run_trial(rng, poses):
    """Return (12,) error, sigma, and uncalibrated error of both triads; NaN without an estimate."""
    accel, gyro = draw_errors(rng, 0.3), draw_errors(rng, 0.02)
    data = carry(rng, gyro, accel, attitudes=poses(rng))
    result = calibrate_imu(data.t, data.gyro, data.accel, gravity=GRAVITY)
    # By convention the accelerometer matrix is symmetric; the gyros refer to that frame.
    symmetric = np.real(sqrtm(triad_matrix(accel) @ triad_matrix(accel).T))
    frame = np.linalg.solve(symmetric, triad_matrix(accel))
    truth = {"accel": (accel.b, symmetric), "gyro": (gyro.b, triad_matrix(gyro) @ frame.T)}
    observed = {
        "accel": result.accel.is_observable,
        "gyro": np.append(np.ones(3, bool), result.gyro.is_observable),
    }
    sigma = {"accel": result.accel.sigma, "gyro": np.sqrt(np.diag(result.gyro.covariance))}
    triads = {"accel": result.accel.triad, "gyro": result.gyro.triad}
    output = {}
    for sensor, (bias, m) in truth.items():
        reported = np.append(triads[sensor].bias, triads[sensor].matrix)
        error = np.where(observed[sensor], reported - np.append(bias, m), np.nan)
        output[sensor] = error, sigma[sensor], np.append(bias, m - np.eye(3))
    return output


def main():
    parser = script_parser(__doc__, seeds=60, first=0)
    args = parser.parse_args()
    print(f"poses of an IMU, seeds {args.first} to {args.first + args.seeds - 1}")
    print(f"{'poses':36s} {'triad':6s} {'what':7s} {'shown':>6s} {'rms':>9s} {'without':>9s} {'rms z':>6s}")
    for name, poses in POSES.items():
        trials, refused = [], 0
        for seed in range(args.first, args.first + args.seeds):
            try:
                trials.append(run_trial(np.random.default_rng(seed), poses))
            except CalibrationError:
                refused += 1
        print_rows(name, trials, refused)


def print_rows(name, trials, refused):
    for sensor in ("accel", "gyro") if trials else ():
        error, sigma, without = (np.array([t[sensor][k] for t in trials]) for k in range(3))
        for kind, places in KINDS.items():
            e, s, w = (v[:, list(places)] for v in (error, sigma, without))
            known = np.isfinite(e)
            cells = (
                ""
                if not known.any()
                else (f"{rms(e[known]):9.2g} {rms(w[known]):9.2g} {rms(e[known] / s[known]):6.2f}")
            )
            print(f"{name:36s} {sensor:6s} {kind:7s} {known.mean():6.0%} {cells}", flush=True)
    if refused:
        print(f"{name:36s} refused {refused}")


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


if __name__ == "__main__":
    main()
