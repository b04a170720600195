"""Six single angles of a gyro triad, all unequal: Avrutov's own method and ours on the same poses.

    python tests/papers/avrutov_separation.py [--seeds 30] [--first 0]

The paper's nine parameters hold differences of angles; each angle is then half of one, with the sign for a
triad that is not rotated as a whole. That is correct only if the angles are equal and opposite. Our method
also uses the angle between gravity and Earth rate, or the turns between the poses. The bound is that of
Cramér and Rao for the means of the rests, with bias and matrix of both triads and the attitude of every pose
unknown.
"""

import sys
from pathlib import Path

import numpy as np
from scipy.linalg import block_diag, sqrtm
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from generators.poses import EARTH, GRAVITY, Errors, carry
from hubodo.sensors.imu.calibrate import calibrate_imu
from hubodo.sensors.imu.scalar_calibration import fit_scalar_calibration
from script_arguments import script_parser

POSES, REST, RATE = 24, 6.0, 100.0
LATITUDE = np.radians(50.4)
ACCEL_NOISE = 0.01
NAMES = ("xz", "xy", "yz", "yx", "zy", "zx")
OFF_DIAGONAL = [1, 2, 3, 5, 6, 7]


def drawn(rng, bias):
    """Return a triad with six unequal angles of 1 %."""
    angles = {name: 0.01 * rng.standard_normal() for name in NAMES}
    return Errors(tuple(bias * rng.standard_normal(3)), tuple(0.003 * rng.standard_normal(3)), angles)


def matrix(errors):
    """Return the (3, 3) matrix of a triad from its measurements of unit vectors."""
    return errors.measure(np.eye(3)).T - np.array(errors.b)[:, None]


def bound(attitudes, gyro_noise):
    """Return the rms Cramér-Rao 1σ, rad, of the off-diagonal elements of the gyro matrix, for small
    errors.
    """
    count = round(REST * RATE)
    earth = np.array([0.0, np.cos(LATITUDE), np.sin(LATITUDE)])
    parts = []
    shared = []
    for attitude in attitudes:
        rate, force = attitude.inv().apply([EARTH * earth, [0.0, 0.0, GRAVITY]])
        # Rows: three gyros, three accelerometers; columns: bias and matrix of the gyros, bias and symmetric
        # matrix of the accelerometers.
        gyro = np.hstack([np.eye(3), np.kron(np.eye(3), rate)])
        x, y, z = force
        symmetric = np.array([[x, 0, 0, y, z, 0], [0, y, 0, x, 0, z], [0, 0, z, 0, x, y]])
        shared.append(block_diag(gyro, np.hstack([np.eye(3), symmetric])))
        parts.append(np.vstack([np.cross(np.eye(3), rate).T, np.cross(np.eye(3), force).T]))
    sigma = np.tile([gyro_noise] * 3 + [ACCEL_NOISE] * 3, len(parts)) / np.sqrt(count)
    rows = np.hstack([np.vstack(shared), block_diag(*parts)]) / sigma[:, None]
    covariance = np.linalg.inv(rows.T @ rows)
    return float(np.sqrt(np.mean(np.diag(covariance)[3:12][OFF_DIAGONAL])))


def trial(seed, gyro_noise, bias, latitude):
    """Return the errors, (6,), of the paper's angles and of ours, and our sigmas, rad."""
    rng = np.random.default_rng(seed)
    gyro, accel = drawn(rng, bias), drawn(rng, 0.1)
    attitudes = Rotation.random(POSES, rng=rng)
    noise = {"gyro_noise": gyro_noise, "accel_noise": ACCEL_NOISE}
    data = carry(rng, gyro, accel, attitudes=attitudes, standstill_s=REST, latitude=LATITUDE, **noise)
    result = calibrate_imu(data.t, data.gyro, data.accel, gravity=GRAVITY, latitude=latitude)
    symmetric = np.real(sqrtm(matrix(accel) @ matrix(accel).T))
    truth = (matrix(gyro) @ np.linalg.solve(symmetric, matrix(accel)).T).ravel()[OFF_DIAGONAL]
    ours = result.gyro.triad.matrix.ravel()[OFF_DIAGONAL] - truth
    sigma = np.sqrt(np.diag(result.gyro.covariance))[3:][OFF_DIAGONAL]
    theirs = None
    if latitude is not None:
        alone = fit_scalar_calibration(
            result.standstills.gyro, EARTH, result.standstills.gyro_sigma, name="gyro"
        )
        theirs = alone.triad.matrix.ravel()[OFF_DIAGONAL] - truth
    return theirs, ours, sigma, truth, bound(attitudes, gyro_noise)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def main():
    parser = script_parser(__doc__, seeds=30, first=0)
    args = parser.parse_args()
    seeds = range(args.first, args.first + args.seeds)
    print(f"Avrutov 2010, six unequal angles, {POSES} poses, seeds {seeds[0]} to {seeds[-1]}, mrad rms")
    print(f"{'gyros':44s} {'not calibrated':>14s} {'paper':>7s} {'ours':>8s} {'bound':>8s} {'rms z':>6s}")
    kinds = {
        "1e-6 rad/s a sample, by Earth rate": (1e-6, 1e-6, LATITUDE),
        "4e-6 rad/s a sample, by Earth rate": (4e-6, 1e-6, LATITUDE),
        "4 mrad/s a sample (MEMS), by turns": (4e-3, 0.02, None),
    }
    for name, (noise, bias, latitude) in kinds.items():
        trials = [trial(seed, noise, bias, latitude) for seed in seeds]
        theirs = "-" if latitude is None else f"{1e3 * rms([t[0] for t in trials]):.2f}"
        ours, sigma, truth, limit = (np.array([t[k] for t in trials]) for k in range(1, 5))
        bounded = "-" if latitude is None else f"{1e3 * rms(limit):.3f}"
        print(
            f"{name:44s} {1e3 * rms(truth):14.2f} {theirs:>7s} {1e3 * rms(ours):8.3f} {bounded:>8s} "
            f"{rms(ours / sigma):6.2f}",
            flush=True,
        )
    print("paper: nothing by turns; its reference is Earth rate, which such gyros do not see.")


if __name__ == "__main__":
    main()
