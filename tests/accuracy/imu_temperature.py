"""IMU calibration while the temperature changes: coverage of biases, scales and terms of the temperature.

    python tests/accuracy/imu_temperature.py [--seeds 20] [--first 0] [--poses 36]

Columns: share of errors within 1.96 of their sigma, with its binomial 95 % interval, of bias, scale and
cross-axis terms at 25 °C (where no term of the temperature is written: at the mean of the poses), and of the
coefficients of the temperature; rms error of the gyro bias over the temperatures of the record, in deg/h, by
the calibration, by a constant bias ("plain"), and by least squares of the true order ("bound").
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parent))

from imu_records import coverage, draw_errors, pulls_of, rms

from generators.poses import GRAVITY
from generators.warm_poses import PROFILES, carry_warm, draw_warmth, polynomial
from hubodo.errors import HubodoError
from hubodo.sensors.imu.calibrate import calibrate_imu
from script_arguments import script_parser

SUFFIXES = ("", "_quadratic", "_cubic")
STANDSTILL, GYRO_NOISE, STEP = 6.0, 0.004, 0.02
ROWS = (
    *(("up and down", order, scales, 0.0) for order in (1, 2, 3) for scales in (False, True)),
    ("two cycles, 30 to 50 °C", 1, True, 0.0),
    ("two cycles, 30 to 50 °C", 2, True, 0.0),
    ("ramp", 1, True, 0.0),
    ("up and down", 1, False, 0.1),
    ("constant", 1, False, 0.0),
)


def coefficient_pulls(result, warmth):
    """Return errors over sigma of the coefficients in the calibration file, by effect."""
    truths = {
        "gyro_temperature": warmth.gyro,
        "accel_temperature": warmth.accel,
        "gyro_scale_temperature": warmth.gyro_scale[None],
        "accel_scale_temperature": warmth.accel_scale[None],
    }
    effects = result.effect_parameters()
    return {
        name: [
            (effects[name][axis + suffix].value - (truth[n][k] if n < len(truth) else 0.0))
            / effects[name][axis + suffix].sigma
            for n, suffix in enumerate(SUFFIXES)
            for k, axis in enumerate("xyz")
            if axis + suffix in effects[name]
        ]
        for name, truth in truths.items()
        if name in effects
    }


def true_errors(result, accel, gyro, warmth, profile, poses):
    """Return the errors of both triads as they are stated: at 25 °C, or at the mean of the poses."""
    effects = result.effect_parameters()
    difference = PROFILES[profile]((np.arange(poses) + 0.5) / poses) - 25.0
    stated = []
    for name, errors in (("accel", accel), ("gyro", gyro)):
        b, e = np.array(errors.b), np.array(errors.e)
        if f"{name}_temperature" not in effects:
            b = b + polynomial(getattr(warmth, name), difference).mean(axis=0)
        if f"{name}_scale_temperature" not in effects:
            e = e + getattr(warmth, f"{name}_scale") * difference.mean()
        stated.append(replace(errors, b=tuple(b), e=tuple(e)))
    return stated


def curve_errors(result, warmth, gyro, profile, poses):
    """Return the errors of the gyro bias over the temperatures of the record, rad/s, by method."""
    temperature = PROFILES[profile](np.linspace(0.0, 1.0, 50))
    true = np.array(gyro.b) + polynomial(warmth.gyro, temperature - 25.0)
    effects = result.effect_parameters()
    own = np.array([effects["gyro_bias"][axis].value for axis in "xyz"])
    terms = effects.get("gyro_temperature", {})
    rows = [[terms[axis + s].value for axis in "xyz"] for s in SUFFIXES if "x" + s in terms]
    shown = own + polynomial(np.array(rows).reshape(-1, 3), temperature - 25.0)
    at_poses = PROFILES[profile]((np.arange(poses) + 0.5) / poses) - 25.0
    order = len(warmth.gyro)
    design = at_poses[:, None] ** np.arange(order + 1)
    grid = (temperature - 25.0)[:, None] ** np.arange(order + 1)
    noise = GYRO_NOISE / np.sqrt(STANDSTILL / STEP)
    limit = noise * np.sqrt(np.mean(((grid @ np.linalg.pinv(design)) ** 2).sum(axis=1)))
    return shown - true, true - true.mean(axis=0), limit


def run_row(profile, order, scales, hysteresis, seeds, poses):
    pulls, coefficients, curves, orders, refused = {"accel": [], "gyro": []}, {}, [], [], 0
    for seed in seeds:
        rng = np.random.default_rng([seed, order, len(profile), scales])
        accel, gyro = draw_errors(rng, 0.3), draw_errors(rng, 0.02)
        warmth = draw_warmth(rng, order, scales)
        options = {"poses": poses, "dt": STEP, "standstill_s": STANDSTILL, "gyro_noise": GYRO_NOISE}
        t, rate, force, temperature = carry_warm(
            rng, gyro, accel, warmth, profile, hysteresis=hysteresis, **options
        )
        try:
            result = calibrate_imu(t, rate, force, gravity=GRAVITY, temperature=temperature)
        except HubodoError as error:
            refused += 1
            print(error)
            continue
        true = true_errors(result, accel, gyro, warmth, profile, poses)
        for triad, z in pulls_of(result, *true).items():
            pulls[triad].append(z)
        for name, z in coefficient_pulls(result, warmth).items():
            coefficients.setdefault(name, []).extend(z)
        curves.append(curve_errors(result, warmth, gyro, profile, poses))
        terms = result.effect_parameters()
        orders.append(sum("x" + s in terms.get("gyro_temperature", {}) for s in SUFFIXES))
    name = f"{profile}, order {order}{', scales' if scales else ''}{', hysteresis' if hysteresis else ''}"
    cells = " ".join(coverage(np.concatenate(z)) for z in pulls.values())
    degrees = [np.degrees(3600.0 * rms(np.array([c[k] for c in curves]))) for k in range(3)]
    print(
        f"{name:46s} {cells} {degrees[0]:7.1f} {degrees[1]:7.1f} {degrees[2]:7.1f}  "
        f"{np.bincount(orders, minlength=4).tolist()} {refused:3d}"
    )
    for effect, z in coefficients.items():
        print(f"    {effect:42s} {coverage(np.array(z))}", flush=True)


def main():
    parser = script_parser(__doc__, seeds=20, first=0)
    parser.add_argument("--poses", type=int, default=36)
    args = parser.parse_args()
    seeds = range(args.first, args.first + args.seeds)
    print(f"{args.poses} poses, seeds {seeds[0]} to {seeds[-1]}; orders: records by the order of the gyros")
    head = f"{'coverage, accel':>20s} {'coverage, gyro':>20s} {'deg/h':>7s} {'plain':>7s} {'bound':>7s}"
    print(f"{'':46s} {head}  orders refused")
    for row in ROWS:
        run_row(*row, seeds, args.poses)


if __name__ == "__main__":
    main()
