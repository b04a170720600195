"""Wheel-INS, the published method for one IMU on one wheel, beside hubodo: a real car and simulated loops.

    python tests/accuracy/wheel_ins.py [--drives 20] [--first-seed 1000] [--only car]

The method is written from its equations (tests/papers/filters/wheel_ins.py), with the settings of its authors
and with those of the car's sensors. Each wheel of the car is scored as in car.py: by tape, and with a radius
that makes another drive of that wheel as long as its reference. The loops are those of odometry.py.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

import car  # noqa: E402
from odometry import STANDSTILL_S, run_filter  # noqa: E402

from generators import wheel_drives  # noqa: E402
from hubodo.errors import CalibrationError  # noqa: E402
from hubodo.recording import Recording, Table  # noqa: E402
from papers.filters.wheel_ins import WheelIns, WheelInsNoise  # noqa: E402
from script_arguments import script_parser  # noqa: E402

G = 9.80665
SETTINGS = {
    "settings of its authors": WheelInsNoise(),
    # Xsens DOT: 0.007 °/s/√Hz, 120 µg/√Hz, 10 °/h, 30 µg; 0.5 % of scale, 0.1 m/s for tyre and road.
    "noise of these sensors": WheelInsNoise(
        math.radians(0.007), 120e-6 * G, math.radians(10.0) / 3600.0, 30e-6 * G, 5e-3, 5e-3
    ),
    "chosen on these drives": WheelInsNoise(
        math.radians(0.007), 0.05, math.radians(10.0) / 3600.0, 0.05, 0.01, 0.01, speed=(0.1, 0.1, 0.1)
    ),
}
SIDES = ("left", "right")
CAR_STANDSTILL_S = 2.0


def main() -> int:
    """Print the errors on the car and on the loops."""
    parser = script_parser(__doc__, drives=20, first_seed=1000)
    parser.add_argument("--only", choices=["car", "loops"])
    args = parser.parse_args()
    if args.only != "loops":
        _print_car(car.drives())
    if args.only != "car":
        _print_loops(range(args.first_seed, args.first_seed + args.drives))
    return 0


def _print_car(logs: dict[str, Recording]) -> None:
    print("real car, one wheel, largest error in % of the path: median of drives and wheels")
    for name, noise in SETTINGS.items():
        print(f"  Wheel-INS, {name}: {_medians(_wheel_ins_errors(logs, noise))}")
    print(f"  hubodo: {_medians(_hubodo_errors(logs))}")


def _medians(errors: Iterator[tuple[bool, float]]) -> str:
    tape, calibrated = [], []
    for is_calibrated, error in errors:
        (calibrated if is_calibrated else tape).append(error)
    return (
        f"by tape {np.median(tape):.2f} of {len(tape)} runs, "
        f"calibrated on another drive {np.median(calibrated):.2f} of {len(calibrated)}"
    )


def _wheel_ins_errors(logs: dict[str, Recording], noise: WheelInsNoise) -> Iterator[tuple[bool, float]]:
    for log, name in _wheels(logs):
        truth = car.truth_of(log)
        t, positions = _car_positions(log, name, car.CAR.wheel_radius, noise)
        yield False, car.largest_distance_percent(t, positions, truth)
        track, reference = car.aligned(t, positions, truth)
        ratio = float(np.vdot(track, reference).real / np.vdot(track, track).real)
        for other in _others(logs, log, name):
            elsewhere = _car_positions(other, name, car.CAR.wheel_radius * ratio, noise)
            yield True, car.largest_distance_percent(*elsewhere, car.truth_of(other))


def _hubodo_errors(logs: dict[str, Recording]) -> Iterator[tuple[bool, float]]:
    for log, name in _wheels(logs):
        yield False, car.largest_percent(log, (name,), None)
        try:
            calibration = car.calibration_from(log, (name,))
        except CalibrationError as error:
            print(f"  hubodo, {name}: {error}")
            continue
        for other in _others(logs, log, name):
            yield True, car.largest_percent(other, (name,), calibration)


def _wheels(logs: dict[str, Recording]) -> Iterator[tuple[Recording, str]]:
    return ((log, name) for log in logs.values() for name in SIDES if name in log.nodes)


def _others(logs: dict[str, Recording], log: Recording, name: str) -> list[Recording]:
    return [other for other in logs.values() if other is not log and name in other.nodes]


def _car_positions(
    log: Recording, name: str, radius: float, noise: WheelInsNoise
) -> tuple[np.ndarray, np.ndarray]:
    sign = 1 if name == "left" else -1
    track = WheelIns(radius, axle_sign=sign, noise=noise).run(*_samples(log.nodes[name]), CAR_STANDSTILL_S)
    to_middle = -0.5j * sign * car.CAR.track_width
    return track.t, track.x + 1j * track.y + to_middle * np.exp(1j * track.heading)


def _samples(table: Table) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    gyro, accel = (np.column_stack([table[f"{kind}{axis}"] for axis in "xyz"]) for kind in "ga")
    return table.t, gyro, accel


def _print_loops(seeds: range) -> None:
    rows: dict[str, list[float]] = {}
    for seed in seeds:
        rng = np.random.default_rng(seed)
        drive = wheel_drives.drive(wheel_drives.loop(rng), rng)
        for name in list(SETTINGS)[:2]:
            rows.setdefault(f"Wheel-INS, {name}", []).append(_loop_error(drive, SETTINGS[name]))
        rows.setdefault("hubodo", []).append(run_filter(drive, ("left",))[0])
    print(f"loops of 250 m, one wheel, seeds {seeds[0]}..{seeds[-1]}: error at the end in % of the path")
    for name, errors in rows.items():
        print(f"  {name}: median {np.median(errors):.2f}, 90 % {np.percentile(errors, 90):.2f}")


def _loop_error(drive: wheel_drives.WheelDrive, noise: WheelInsNoise) -> float:
    node = drive.nodes["left"]
    track = WheelIns(drive.radius, noise=noise).run(node.t, node.gyro, node.accel, STANDSTILL_S)
    to_middle = -0.5j * drive.track * np.exp(1j * (track.heading - track.heading[0]))
    positions = (track.x + 1j * track.y) * np.exp(-1j * track.heading[0])
    end = positions[-1] + to_middle[-1] - to_middle[0]
    truth = [np.interp(track.t[-1], drive.t, column) for column in (drive.x, drive.y)]
    return float(100.0 * abs(end - complex(*truth)) / drive.length)


if __name__ == "__main__":
    sys.exit(main())
