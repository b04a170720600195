"""Calibration of a gyro axis on a rate table: coverage of the sigmas, beside numpy's polyfit.

    python tests/accuracy/rate_table.py [--seeds 20] [--first 0]

The generator is `tests/generators/rate_table.py`. Truth: line and deviations of the noise-free readings
at the same rates. Coverage: share of errors within 1.96 sigma, with its binomial 95 % interval. "plain":
scale error by polyfit through the means of all plateaus, whose sigma is that of its covariance.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from imu_records import coverage, rms

from generators.odd_records import missing_codes
from generators.rate_table import Axis, slip, turn_table
from hubodo.errors import HubodoError
from hubodo.sensors.rate_table.calibrate import RateOptions, calibrate_rate
from script_arguments import script_parser

BASE = Axis(bias=0.01, scale=0.004)
CASES = {
    "white noise alone": BASE,
    "asymmetry 2000 ppm": replace(BASE, asymmetry=2e-3),
    "cubic, 2000 ppm at full scale": replace(BASE, cubic=2e-3 / 3.49**2),
    "hysteresis 500 ppm of full scale": replace(BASE, hysteresis=5e-4 * 3.49),
    "all three": replace(BASE, asymmetry=2e-3, cubic=2e-3 / 3.49**2, hysteresis=5e-4 * 3.49),
    "bias walks 5e-5 rad/s per √s": replace(BASE, walk=5e-5),
    "bias walks 3e-4 rad/s per √s": replace(BASE, walk=3e-4),
    "output step 0.07 deg/s": replace(BASE, step=1.2e-3),
    "output step 1 deg/s": replace(BASE, step=1.7e-2),
}
CHANGES = {
    "uneven and missing codes": lambda rng, t, reading, _: missing_codes(t, reading[:, None], None, rng, 0)[
        1
    ][:, 0],
    "3 of 33 plateaus slip by up to 1 %": lambda *record: slip(*record, 3),
    "10 of 33 plateaus slip by up to 1 %": lambda *record: slip(*record, 10),
}


def run_trial(axis, rng, from_list, change=None):
    """Return pulls by figure, and error of the scale with that of polyfit and its sigma."""
    t, gyro, table = turn_table(rng, axis)
    if change is not None:
        gyro = change(rng, t, gyro, table)
    options = RateOptions(rates=table[:, 1]) if from_list else RateOptions(table=(table[:, 0], table[:, 1]))
    result = calibrate_rate(t, gyro, "imu", "z", options)
    fit, rates = result.fit, result.fit.rates
    slope, _ = np.polyfit(rates, axis.static(rates), 1)
    line = np.polyval(np.polyfit(rates, axis.static(rates), 1), rates)
    scale = fit.scale_error.value - (slope - 1)
    pulls = {
        "scale": [scale / fit.scale_error.sigma],
        "asymmetry": [(fit.asymmetry.value - axis.asymmetry / (1 + axis.scale)) / fit.asymmetry.sigma],
        "hysteresis": [(fit.hysteresis.value - axis.hysteresis) / fit.hysteresis.sigma],
        "deviations": (fit.deviation - (axis.static(rates) - line)) / fit.deviation_sigma,
    }
    plain, covariance = np.polyfit(result.plateaus.rate, result.plateaus.reading, 1, cov=True)
    return pulls, scale, plain[0] - slope, (plain[0] - slope) / np.sqrt(covariance[0, 0]), result.is_nonlinear


def main():
    parser = script_parser(__doc__, seeds=20, first=0)
    args = parser.parse_args()
    seeds = range(args.first, args.first + args.seeds)
    print(
        f"gyro on a rate table, 33 plateaus of 20 s, seeds {seeds[0]} to {seeds[-1]}; scale error in ppm, rms"
    )
    names = ("scale", "asymmetry", "hysteresis", "deviations")
    print(
        f"{'':34s} {''.join(f'{name:>22s}' for name in names)} {'scale':>7s} {'plain':>7s} {'nonlinear':>10s}"
    )
    for case, axis in (CASES | dict.fromkeys(CHANGES, BASE)).items():
        rows, refused = [], 0
        for seed in seeds:
            try:
                rows.append(
                    run_trial(axis, np.random.default_rng([seed, 34]), seed % 2 == 0, CHANGES.get(case))
                )
            except HubodoError as error:
                refused, reason = refused + 1, str(error)
        if not rows:
            print(f"{case:34s} refused {refused}: {reason}", flush=True)
            continue
        cells = "".join(f"{coverage(np.concatenate([row[0][name] for row in rows])):>22s}" for name in names)
        errors = [1e6 * rms([row[k] for row in rows]) for k in (1, 2)]
        nonlinear = sum(row[4] for row in rows)
        print(
            f"{case:34s} {cells} {errors[0]:7.1f} {errors[1]:7.1f} {nonlinear:10d}  refused {refused}",
            flush=True,
        )


if __name__ == "__main__":
    main()
