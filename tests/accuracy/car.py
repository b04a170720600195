"""Wheel odometry of a real car with an RTK reference: calibrated on one drive, tested on the others.

    python tests/accuracy/car.py

The error is the largest distance from the reference, in % of the path. The track starts at the reference
position and is rotated to the best fit, because the heading of a stationary car is not known. The baseline is
the vehicle file with a radius and a track width measured by tape; beside its error stands the one of the same
track scaled to the reference, which is what a correct radius would give.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

import wanted  # noqa: E402
from hubodo.calibration.file import Calibration  # noqa: E402
from hubodo.errors import CalibrationError  # noqa: E402
from hubodo.fuse.wheel.calibration.calibrate import calibrate_wheels  # noqa: E402
from hubodo.fuse.wheel.calibration.positions import Positions  # noqa: E402
from hubodo.fuse.wheel.config import wheel_config  # noqa: E402
from hubodo.fuse.wheel.track import run_wheel_filter  # noqa: E402
from hubodo.log.csv_folder import read_folder  # noqa: E402
from hubodo.recording import Recording, Table  # noqa: E402
from hubodo.vehicle import NodeMount, Vehicle  # noqa: E402
from hubodo.verbs.calibrate_wheels import TRUTH_SIGMA  # noqa: E402

CAR = Vehicle(
    0.2924,
    1.42,
    {"left": NodeMount("left", "left"), "right": NodeMount("right", "right")},
    radius_from="tape",
)
SETS = (("left",), ("right",), ("left", "right"))


def drives() -> dict[str, Recording]:
    """Return the recordings of sensors near the rear axle, by name; those of rims and front wheels are
    left out.
    """
    folders = sorted(wanted.recording("car").glob("drive-[0-9]"))
    return {path.name: read_folder(path) for path in folders}


def truth_of(log: Recording) -> Table:
    """Return the reference trajectory, which every drive has."""
    assert log.truth is not None
    return log.truth


def calibration_from(log: Recording, names: tuple[str, ...]) -> Calibration:
    """Return the calibration from a drive of these nodes. Raises CalibrationError."""
    truth = truth_of(log)
    reported = Positions(truth.t, truth["x"], truth["y"], np.full(len(truth), TRUTH_SIGMA))
    result = calibrate_wheels(wheel_config(with_nodes(names), list(names)), log.nodes, reported)
    output = Calibration().with_vehicle(result.vehicle_effects())
    for name in names:
        output = output.with_node(name, result.effects(name))
    return output


def largest_percent(log: Recording, names: tuple[str, ...], calibration: Calibration | None) -> float:
    """Return the largest distance from the reference in % of the path."""
    return largest_distance_percent(*_estimate(log, names, calibration), truth_of(log))


def tape_percent(log: Recording, names: tuple[str, ...]) -> tuple[float, float, float]:
    """Return the largest distance with dimensions by tape, the correction of the radius that fits the track
    to the reference, and the largest distance with it, all in %.
    """
    t, positions = _estimate(log, names, None)
    track, reference = aligned(t, positions, truth_of(log))
    scale = float(np.sum(reference * track.conj()).real / np.sum(np.abs(track) ** 2))
    truth = truth_of(log)
    errors = [largest_distance_percent(t, factor * positions, truth) for factor in (1.0, scale)]
    return errors[0], 100.0 * (scale - 1.0), errors[1]


def _estimate(
    log: Recording, names: tuple[str, ...], calibration: Calibration | None
) -> tuple[np.ndarray, np.ndarray]:
    track = run_wheel_filter(wheel_config(with_nodes(names), list(names), calibration), log.nodes).track
    return track.t, track.x + 1j * track.y


def with_nodes(names: tuple[str, ...]) -> Vehicle:
    """Return the car with these nodes only."""
    return replace(CAR, nodes={name: CAR.nodes[name] for name in names})


def aligned(t: np.ndarray, positions: np.ndarray, truth: Table) -> tuple[np.ndarray, np.ndarray]:
    """Return the (M,) positions within the reference's time, rotated to its best fit, and the reference's.

    t: (N,) s; positions: (N,) x + iy, m. Both results begin at 0.
    """
    inside = (t >= truth.t[0]) & (t <= truth.t[-1])
    reference = np.interp(t[inside], truth.t, truth["x"]) + 1j * np.interp(t[inside], truth.t, truth["y"])
    track, reference = positions[inside] - positions[inside][0], reference - reference[0]
    return track * np.exp(1j * np.angle(np.sum(reference * track.conj()))), reference


def largest_distance_percent(t: np.ndarray, positions: np.ndarray, truth: Table) -> float:
    """Return the largest distance of positions from the reference in % of the path; see `aligned`."""
    track, reference = aligned(t, positions, truth)
    return float(100.0 * np.abs(track - reference).max() / np.sum(np.abs(np.diff(reference))))


def main() -> int:
    """Print a line for each drive, and each pair of drives; then the medians of one wheel and of two."""
    logs = drives()
    by_wheels: dict[int, tuple[list[float], list[float], list[float]]] = {1: ([], [], []), 2: ([], [], [])}
    for names in SETS:
        usable_logs = {name: log for name, log in logs.items() if set(names) <= set(log.nodes)}
        tapes = {name: tape_percent(log, names) for name, log in usable_logs.items()}
        print(" and ".join(names))
        for name, (error, scale, without) in tapes.items():
            print(
                f"  tape measure           on {name}: {error:.2f} %; "
                f"radius {scale:+.2f} %, with it {without:.2f} %"
            )
        calibrated = []
        for first, log in usable_logs.items():
            try:
                calibration = calibration_from(log, names)
            except CalibrationError as error:
                print(f"  calibrated on {first}: {error}")
                continue
            for name in usable_logs:
                if name != first:
                    calibrated.append(largest_percent(usable_logs[name], names, calibration))
                    print(f"  calibrated on {first}  on {name}: {calibrated[-1]:.2f} %")
        print(
            f"  median: tape {np.median([error for error, _, _ in tapes.values()]):.2f} %, "
            f"calibrated {np.median(calibrated):.2f} %"
        )
        for values, more in zip(
            by_wheels[len(names)],
            ([it[0] for it in tapes.values()], [it[2] for it in tapes.values()], calibrated),
            strict=True,
        ):
            values.extend(more)
    for count, (tape, scaled, calibrated) in by_wheels.items():
        print(
            f"wheels: {count}; medians: tape {np.median(tape):.2f} % of {len(tape)} runs, "
            f"with the correct radius {np.median(scaled):.2f} %, calibrated on another drive "
            f"{np.median(calibrated):.2f} % of {len(calibrated)}"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
