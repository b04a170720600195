"""Calibration of an IMU from records that are not ideal: coverage of the sigmas, or a refusal with its cause.

    python tests/accuracy/imu_records.py [--seeds 20] [--first 0] [--only PART]

PART: quantised, rates, earth, faults or disturbed.
Coverage: share of errors within 1.96 of their sigma, with its binomial 95 % interval (Clopper and Pearson).
"plain" is Avrutov's eq. 6 solved once, "bound" the Cramér-Rao 1σ for the rounding and noise simulated.
"""

import sys
from pathlib import Path

import numpy as np
from scipy.linalg import sqrtm
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation
from scipy.stats import beta

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from generators.odd_records import missing_codes
from generators.poses import GRAVITY, Errors, carry
from hubodo.errors import HubodoError
from hubodo.sensors.imu.calibrate import calibrate_imu
from hubodo.sensors.imu.turn_calibration import calibrate_from_turns
from hubodo.sensors.imu.turns import collect_turns
from script_arguments import script_parser

FREE = [0, 1, 2, 3, 4, 5, 7, 8, 11]
"""Bias, and the six elements of a symmetric matrix."""
SYMMETRIC = [np.diag(e) for e in np.eye(3)] + [
    np.outer(a, b) + np.outer(b, a)
    for a, b in ((np.eye(3)[0], np.eye(3)[1]), (np.eye(3)[0], np.eye(3)[2]), (np.eye(3)[1], np.eye(3)[2]))
]
REST = 4.0


def draw_errors(rng, bias, size=0.01):
    """Return errors of one triad; `size`: 1σ of scale and angles."""
    angles = {name: size * rng.standard_normal() for name in ("xz", "xy", "yz", "yx", "zy", "zx")}
    return Errors(tuple(bias * rng.standard_normal(3)), tuple(size * rng.standard_normal(3)), angles)


def triad_matrix(errors):
    """Return the (3, 3) matrix of a triad, from its measurements of unit vectors."""
    return errors.measure(np.eye(3)).T - np.array(errors.b)[:, None]


def solve_once(u):
    """Return bias and diagonal of the matrix by eq. 6 of Avrutov, with the raw readings as directions."""
    x, y, z = (u / np.linalg.norm(u, axis=1)[:, None]).T
    rows = np.column_stack([x, y, z, x * x, y * y, z * z, x * y, x * z, y * z])
    return np.linalg.lstsq(rows, ((u**2).sum(axis=1) - 1) / 2, rcond=None)[0][:6] * ([GRAVITY] * 3 + [1] * 3)


def bound(attitudes, accel, sigma):
    """Return the (9,) Cramér-Rao 1σ of bias and symmetric matrix for means with errors of `sigma`."""
    force = attitudes.inv().apply([0.0, 0.0, GRAVITY])
    # |S^-1 (u - b)|: S is the symmetric matrix with the norms of the triad's.
    matrix = triad_matrix(accel)
    symmetric = np.real(sqrtm(matrix @ matrix.T))
    inverse = np.linalg.inv(symmetric)
    true = force @ np.linalg.solve(symmetric, matrix).T / GRAVITY
    slope = true @ inverse
    columns = [slope, *[((slope @ one) * true).sum(axis=1) for one in SYMMETRIC]]
    rows = np.column_stack(columns) / (sigma * np.linalg.norm(slope, axis=1))[:, None]
    return np.sqrt(np.diag(np.linalg.inv(rows.T @ rows)))


def interval(hits, count):
    """Return the binomial 95 % interval of a share (Clopper and Pearson)."""
    low = beta.ppf(0.025, hits, count - hits + 1) if hits else 0.0
    return low, beta.ppf(0.975, hits + 1, count - hits) if hits < count else 1.0


def coverage(pulls):
    hits = int(np.sum(np.abs(pulls) < 1.96))
    low, high = interval(hits, len(pulls))
    return f"{hits / len(pulls):5.3f} [{low:.3f}, {high:.3f}]"


def quantised(seeds):
    print(f"\nrounded accelerometers, seeds {seeds[0]} to {seeds[-1]}: bias in m/s², rms")
    print(f"{'':34s} {'coverage of all 9':>20s} {'bias':>8s} {'bound':>8s} {'plain':>8s}  refused")
    for poses in (12, 24):
        for digits in (3, 4, 6, 8, 10):
            for noise in (0.0, 0.3, 3.0):
                rows, refused = [], 0
                for seed in seeds:
                    try:
                        rows.append(quantised_trial(seed, poses, digits, noise))
                    except HubodoError:
                        refused += 1
                name = f"{poses} poses, {digits} digits, noise {noise:g} LSB"
                if not rows:
                    print(f"{name:34s} {'':20s} {'':26s}  {refused}")
                    continue
                error, sigma, limit, plain = (np.array([row[k] for row in rows]) for k in range(4))
                print(
                    f"{name:34s} {coverage((error / sigma)[np.isfinite(error)])} {rms(error[:, :3]):8.1e} "
                    f"{rms(limit[:, :3]):8.1e} {rms(plain):8.1e}  {refused}",
                    flush=True,
                )


def quantised_trial(seed, poses, digits, noise_lsb):
    """Return error and sigma (9,), bound (9,), and the error of the plain method's bias (3,)."""
    rng = np.random.default_rng([seed, poses, digits, round(10 * noise_lsb)])
    accel, gyro = draw_errors(rng, 0.3), draw_errors(rng, 0.02)
    attitudes, step = Rotation.random(poses, rng=rng), 10.0**-digits
    data = carry(
        rng, gyro, accel, attitudes=attitudes, dt=0.02, standstill_s=REST, accel_noise=noise_lsb * step
    )
    result = calibrate_imu(data.t, data.gyro, np.round(data.accel, digits), gravity=GRAVITY)
    matrix = triad_matrix(accel)
    truth = np.append(accel.b, np.real(sqrtm(matrix @ matrix.T)))
    error = np.append(result.accel.triad.bias, result.accel.triad.matrix) - truth
    error = np.where(result.accel.is_observable, error, np.nan)
    samples = REST / 0.02
    sigma = step * (np.sqrt((noise_lsb**2 + 1 / 12) / samples) if noise_lsb > 0.5 else np.sqrt(1 / 12))
    if 0 < noise_lsb <= 0.5:
        # Return the residual variance for dither of this size, by its first harmonic.
        sigma = step * np.sqrt(
            np.exp(-((2 * np.pi * noise_lsb) ** 2)) / (2 * np.pi**2) + noise_lsb**2 / samples
        )
    plain = solve_once(result.standstills.accel / GRAVITY)[:3] - accel.b
    return error[FREE], result.accel.sigma[FREE], bound(attitudes, accel, sigma), plain


def rates(seeds):
    print(f"\nrate of samples, 24 poses, seeds {seeds[0]} to {seeds[-1]}")
    print(f"{'':20s} {'standstills found':18s} {'coverage, accel':>20s} {'coverage, gyro':>20s}")
    for rate_hz in (5, 10, 50, 1000):
        counts, pulls = set(), {"accel": [], "gyro": []}
        for seed in seeds if rate_hz < 100 else seeds[:5]:
            rng = np.random.default_rng([seed, rate_hz])
            accel, gyro = draw_errors(rng, 0.3), draw_errors(rng, 0.02)
            data = carry(rng, gyro, accel, dt=1 / rate_hz, turn=2.4)
            result = calibrate_imu(data.t, data.gyro, data.accel, gravity=GRAVITY)
            counts.add(len(result.standstills))
            for name, z in pulls_of(result, accel, gyro).items():
                pulls[name].append(z)
        cells = " ".join(coverage(np.concatenate(z)) for z in pulls.values())
        print(f"{f'{rate_hz} Hz':20s} {sorted(counts)!s:18s} {cells}", flush=True)


def pulls_of(result, accel, gyro):
    """Return errors in units of sigma of both triads, for the elements that the record determines."""
    matrix = triad_matrix(accel)
    symmetric = np.real(sqrtm(matrix @ matrix.T))
    frame = np.linalg.solve(symmetric, matrix)
    accel_error = np.append(result.accel.triad.bias - accel.b, result.accel.triad.matrix - symmetric)
    gyro_error = np.append(
        result.gyro.triad.bias - gyro.b, result.gyro.triad.matrix - triad_matrix(gyro) @ frame.T
    )
    gyro_observable = np.append(np.ones(3, bool), result.gyro.is_observable)
    return {
        "accel": (accel_error / result.accel.sigma)[FREE][result.accel.is_observable[FREE]],
        "gyro": gyro_error[gyro_observable] / np.sqrt(np.diag(result.gyro.covariance)[gyro_observable]),
    }


def earth(seeds):
    print(
        f"\nEarth rate at 57 degrees, gyros of 2e-4 rad/s a sample, 16 poses, seeds {seeds[0]} to {seeds[-1]}"
    )
    print(f"{'':34s} {'coverage, bias':>20s} {'coverage, scale':>20s} {'scale':>7s} {'plain':>7s}  refused")
    for turn in (2.5, 30.0):
        for given in (None, 1.0, -1.0, 0.5):
            rows, plain, refused = [], [], 0
            for seed in seeds:
                rng = np.random.default_rng([seed, round(turn)])
                accel, gyro = draw_errors(rng, 0.3), draw_errors(rng, 0.02)
                kinds = {"gyro_noise": 2e-4, "standstill_s": 8.0, "latitude": 1.0}
                data = carry(rng, gyro, accel, poses=16, dt=0.05, turn=turn, **kinds)
                try:
                    result = calibrate_imu(data.t, data.gyro, data.accel, gravity=GRAVITY, latitude=given)
                except HubodoError:
                    refused += 1
                    continue
                rows.append(gyro_errors(result, accel, gyro))
                force = result.accel.triad.correct(result.standstills.accel)
                without = collect_turns(data.t, data.gyro, result.gyro.triad.bias, result.standstills, force)
                matrix = calibrate_from_turns(without, np.full(3, 1e-5)).matrix
                plain.append(rows[-1][0][[3, 7, 11]] + np.diag(matrix - result.gyro.triad.matrix))
            name = (
                f"turns of {turn:g} s, latitude {'unknown' if given is None else f'{np.degrees(given):.0f}'}"
            )
            if not rows:
                print(f"{name:34s} {'':58s} {refused}", flush=True)
                continue
            error, sigma = (np.array([row[k] for row in rows]) for k in (0, 1))
            pulls, scale = error / sigma, [3, 7, 11]
            print(
                f"{name:34s} {coverage(pulls[:, :3].ravel())} {coverage(pulls[:, scale].ravel())} "
                f"{100 * rms(error[:, scale]):6.3f}% {100 * rms(plain):6.3f}%  {refused}",
                flush=True,
            )


def gyro_errors(result, accel, gyro):
    """Return the (12,) errors of bias and matrix in the frame of the accelerometers, and their sigmas."""
    matrix = triad_matrix(accel)
    frame = np.linalg.solve(np.real(sqrtm(matrix @ matrix.T)), matrix)
    error = np.append(
        result.gyro.triad.bias - gyro.b, result.gyro.triad.matrix - triad_matrix(gyro) @ frame.T
    )
    return error, np.sqrt(np.diag(result.gyro.covariance))


def nothing(gyro, accel):
    return gyro, accel


def knock(gyro, accel):
    """Offset the ninth pose by 5 mg."""
    offset = np.zeros_like(accel)
    rows = slice(round(8 * 8.5 / 0.02), round((8 * 8.5 + 6) / 0.02))
    offset[rows] = 0.005 * accel[rows]
    return gyro, accel + offset


def drop_sample(gyro, accel):
    changed = accel.copy()
    changed[1000, 1] = np.nan
    return gyro, changed


FAULTS = {
    "none": (nothing, 0.3, 0.01, ""),
    "one pose 5 mg off": (knock, 0.3, 0.01, "mg) off the calibration by the other poses"),
    "gyro y reversed": (lambda g, a: (g * [1, -1, 1], a), 0.3, 0.01, "gyro y is reversed"),
    "accelerometer z reversed": (lambda g, a: (g, a * [1, 1, -1]), 0.3, 0.01, "accelerometer z is reversed"),
    "gyro x for y": (lambda g, a: (g[:, [1, 0, 2]], a), 0.3, 0.01, "in truth gy, gx, gz"),
    "one value not a number": (drop_sample, 0.3, 0.01, "first at 20 s"),
    "accelerometer already calibrated": (nothing, 1e-4, 1e-5, "makes the length of gravity worse"),
}


def faults(seeds):
    print(f"\nfaults, 24 poses, seeds {seeds[0]} to {seeds[-1]}")
    print(f"{'':34s} {'named':>6s} {'refused':>8s} {'coverage of the others, accel':>30s}")
    for name, (change, bias, size, words) in FAULTS.items():
        named, refused, pulls = 0, 0, []
        for seed in seeds:
            rng = np.random.default_rng(seed)
            accel, gyro = draw_errors(rng, bias, size), draw_errors(rng, 0.02)
            data = carry(rng, gyro, accel, dt=0.02)
            try:
                result = calibrate_imu(data.t, *change(data.gyro, data.accel), gravity=GRAVITY)
            except HubodoError as error:
                refused += 1
                named += words in str(error)
                continue
            named += any(words in note for note in result.notes)
            pulls.append(pulls_of(result, accel, gyro)["accel"])
        cells = coverage(np.concatenate(pulls)) if pulls else ""
        named_cell = f"{named}" if words else "-"
        print(f"{name:34s} {named_cell:>6s} {refused:8d} {cells:>30s}", flush=True)


def ramp(data, rng):
    share = (data.t / data.t[-1])[:, None] - 0.5
    drift = np.radians(0.3) * rng.standard_normal(3), 0.05 * rng.standard_normal(3)
    return data.t, data.gyro + share * drift[0], data.accel + share * drift[1]


def correlated(data, rng):
    """Add Gauss-Markov noise with a correlation time of 5 s."""
    p = np.exp(-(data.t[1] - data.t[0]) / 5.0)
    walk = lfilter([np.sqrt(1 - p * p)], [1, -p], rng.standard_normal((len(data.t), 6)), axis=0)
    return data.t, data.gyro + 1e-3 * walk[:, :3], data.accel + 1e-2 * walk[:, 3:]


def gaps(data, rng):
    present = np.ones(len(data.t), bool)
    for start in rng.uniform(0, data.t[-1], 6):
        present &= ~((data.t > start) & (data.t < start + rng.uniform(0.3, 4.0)))
    return data.t[present], data.gyro[present], data.accel[present]


def one_plane(rng):
    angles = np.c_[rng.uniform(-5, 5, (24, 2)), np.linspace(0, 345, 24)]
    return Rotation.from_euler("zyx", angles, degrees=True)


def uneven_codes(data, rng):
    """Convert both sensors with steps as wide as the noise, uneven and with missing codes."""
    _, gyro, _ = missing_codes(data.t, data.gyro, None, rng, 0.0)
    return data.t, gyro, missing_codes(data.t, data.accel, None, rng, 0.0)[1]


DISTURBANCES = {
    "none": lambda d, _: (d.t, d.gyro, d.accel),
    "biases drift by 0.3 deg/s, 5 mg": ramp,
    "correlated noise": correlated,
    "six gaps of 0.3 to 4 s": gaps,
    "turns of 15 degrees in one plane": lambda d, _: (d.t, d.gyro, d.accel),
    "gyro range 1 rad/s": lambda d, _: (d.t, np.clip(d.gyro, -1, 1), d.accel),
    "accelerometer range 9.3 m/s²": lambda d, _: (d.t, d.gyro, np.clip(d.accel, -9.3, 9.3)),
    "accelerometer quadratic, 5 mg": lambda d, _: (d.t, d.gyro, d.accel + 5e-4 * d.accel**2),
    "accelerometer cubic, 5 mg": lambda d, _: (d.t, d.gyro, d.accel + 0.05 * (d.accel / GRAVITY) ** 3),
    "uneven and missing codes": uneven_codes,
    "gyro asymmetry, 0.5 %": lambda d, _: (d.t, d.gyro + 5e-3 * np.abs(d.true_rate), d.accel),
    "gyro cubic, 1 % at 1 rad/s": lambda d, _: (d.t, d.gyro * (1 - 0.01 * d.gyro**2), d.accel),
}


def disturbed(seeds):
    print(f"\ndisturbed records, 24 poses, seeds {seeds[0]} to {seeds[-1]}: silently wrong is beyond 4 sigma")
    print(f"{'':34s} {'coverage, accel':>20s} {'coverage, gyro':>20s}  silently wrong  refused")
    for name, change in DISTURBANCES.items():
        pulls, wrong, refused = {"accel": [], "gyro": []}, 0, 0
        for seed in seeds:
            rng = np.random.default_rng([seed, 77])
            accel, gyro = draw_errors(rng, 0.3), draw_errors(rng, 0.02)
            data = carry(rng, gyro, accel, attitudes=one_plane(rng) if "plane" in name else None)
            try:
                result = calibrate_imu(*change(data, rng), gravity=GRAVITY)
            except HubodoError:
                refused += 1
                continue
            both = pulls_of(result, accel, gyro)
            wrong += any(np.abs(z).max(initial=0.0) > 4 for z in both.values())
            for triad, z in both.items():
                pulls[triad].append(z)
        cells = " ".join(coverage(np.concatenate(z)) if z else f"{'':20s}" for z in pulls.values())
        print(f"{name:34s} {cells} {wrong:15d} {refused:8d}", flush=True)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


PARTS = {"quantised": quantised, "rates": rates, "earth": earth, "faults": faults, "disturbed": disturbed}


def main():
    parser = script_parser(__doc__, seeds=20, first=0)
    parser.add_argument("--only", choices=PARTS)
    args = parser.parse_args()
    seeds = range(args.first, args.first + args.seeds)
    for name, part in PARTS.items():
        if args.only in (None, name):
            part(seeds)


if __name__ == "__main__":
    main()
