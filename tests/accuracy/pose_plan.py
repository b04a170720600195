"""Sigmas promised by `calibrate plan` against errors and sigmas of `calibrate imu` on the planned poses.

    python tests/accuracy/pose_plan.py [--seeds 20] [--first 0]

Records by `tests/generators/poses.py`. Ratios to the planned sigma: rms error of all biases, median of
the sigmas that the calibration reports; 0.8 to 1.25 is as planned.
"""

import sys
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from imu_records import draw_errors

from generators.poses import GRAVITY, carry
from hubodo.sensors.imu.calibrate import calibrate_imu
from hubodo.sensors.imu.pose_plan import choose_directions, plan_poses
from hubodo.sensors.north.drift import DriftNoise
from script_arguments import script_parser

DT = 0.02
CASES = ((0.01, 0.01), (0.002, 0.0012))
"""Noise density, m/s²/√Hz, and requested sigma of the bias, m/s²."""


def attitude_with_up(direction, rng):
    """Return an attitude, node to world, with `direction` of the node up, and any heading."""
    unit = np.asarray(direction) / np.linalg.norm(direction)
    upright, _ = Rotation.align_vectors([[0.0, 0.0, 1.0]], [unit])
    return Rotation.from_euler("z", rng.uniform(0, 360), degrees=True) * upright


def run_trial(seed, density, programme):
    """Return errors and reported sigmas of the three biases."""
    rng = np.random.default_rng([seed, 35])
    directions = choose_directions(len(programme.directions))
    attitudes = Rotation.concatenate([attitude_with_up(it, rng) for it in directions])
    accel, gyro = draw_errors(rng, 0.2, 0.005), draw_errors(rng, 0.02)
    kinds = {"standstill_s": programme.standstill, "accel_noise": density / np.sqrt(DT), "dt": DT}
    data = carry(rng, gyro, accel, attitudes=attitudes, **kinds)
    result = calibrate_imu(data.t, data.gyro, data.accel, gravity=GRAVITY)
    return result.accel.triad.bias - accel.b, result.accel.sigma[:3]


def main():
    parser = script_parser(__doc__, seeds=20, first=0)
    args = parser.parse_args()
    print(f"planned poses, seeds {args.first} to {args.first + args.seeds - 1}")
    print(f"{'noise':>8s} {'poses':>6s} {'standstill':>10s} {'planned':>9s} {'error':>6s} {'reported':>9s}")
    for density, target in CASES:
        for programme in plan_poses(DriftNoise(density, 0.0, 0.0), target, 5.0).programmes:
            seeds = range(args.first, args.first + args.seeds)
            error, sigma = (
                np.array(it) for it in zip(*(run_trial(s, density, programme) for s in seeds), strict=True)
            )
            planned = programme.bias_sigma
            ratios = np.sqrt(np.mean(error**2)) / planned, np.median(sigma) / planned
            print(
                f"{density:8g} {len(programme.directions):6d} {programme.standstill:10g} {planned:9.2e} "
                f"{ratios[0]:6.2f} {ratios[1]:9.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
