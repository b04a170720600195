"""Calibration of wheels from positions of several kinds: consistency of errors and sigmas.

    python tests/accuracy/wheel_calibration.py [--drives 20] [--length 200] [--seed 1000]

The generator shares no code with the model under test. The baseline are radius and track width measured by
tape, compared on held-out segments.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from generators import wheel_drives  # noqa: E402
from generators.external_positions import Receiver, positions  # noqa: E402
from hubodo.errors import CalibrationError  # noqa: E402
from hubodo.fuse.wheel.calibration.calibrate import calibrate_wheels  # noqa: E402
from hubodo.fuse.wheel.calibration.positions import Positions  # noqa: E402
from hubodo.fuse.wheel.calibration.result import WheelCalibration  # noqa: E402
from script_arguments import script_parser  # noqa: E402
from wheel_runs import config, tables  # noqa: E402

ERRORS = replace(wheel_drives.Errors(), radius=0.01, track=0.015)
RECEIVERS = {
    "RTK": (Receiver(), 0.1),
    "RTK that jumps": (Receiver(jumps=2), 0.1),
    "RTK with excursions": (Receiver(excursions=5), 0.1),
    "RTK with slow errors": (Receiver(slow=0.15, memory=8.0), 0.1),
    "RTK with slow errors, jumps and excursions": (
        Receiver(slow=0.12, memory=8.0, jumps=1, excursions=5),
        0.1,
    ),
    "RTK, float": (Receiver(slow=0.5, white=0.05, memory=90.0), 0.1),
    "GNSS": (Receiver(rate_hz=1.0, white=0.7, slow=1.5, memory=120.0, delay=0.05), 1.5),
    "GNSS, white": (Receiver(rate_hz=1.0, white=1.0, slow=0.0), 1.0),
}
TRUTH_OF = {
    ("wheel_radius", "error"): "radius",
    ("lever_arm", "x"): "arm_x",
    ("lever_arm", "y"): "arm_y",
    ("node_misalignment", "x"): "tilt_x",
    ("node_misalignment", "y"): "tilt_y",
    ("gyro_scale_factor", "z"): "spin_scale",
    ("gyro_scale_factor", "x"): "yaw_scale",
}
NormalisedErrors = dict[str, list[float]]


def main() -> int:
    """Print one block of results for each kind of positions."""
    parser = script_parser(__doc__, drives=20)
    parser.add_argument("--length", type=float, default=200.0, help="m of each")
    parser.add_argument("--seed", type=int, default=1000)
    args = parser.parse_args()
    print(f"{args.drives} drives of {args.length:g} m, seeds from {args.seed}")
    for kind, (receiver, declared) in RECEIVERS.items():
        errors: NormalisedErrors = defaultdict(list)
        rms_ratios, refused = [], 0
        for seed in range(args.seed, args.seed + args.drives):
            rng = np.random.default_rng(seed)
            drive = wheel_drives.drive(wheel_drives.loop(rng, args.length, 6.0), rng, ERRORS)
            t, x, y = positions(drive, receiver, seed)
            measured = Positions(t, x, y, np.full(len(t), declared))
            try:
                result = calibrate_wheels(config(drive), tables(drive), measured)
            except CalibrationError:
                refused += 1
                continue
            rms_ratios.append(result.held_out.after.rms / result.held_out.before.rms)
            _add_normalised_errors(errors, drive, result, receiver)
        median = f"{np.median(rms_ratios):.2f}" if rms_ratios else "-"
        print(f"{kind}: {refused} refused; held-out segments, rms relative to tape measure: median {median}")
        for name, values in errors.items():
            rms, largest = np.sqrt(np.mean(np.square(values))), np.abs(values).max()
            print(
                f"  {name:24} observable {len(values):3} times, error / sigma: rms {rms:4.2f}, "
                f"largest {largest:.1f}"
            )
    return 0


def _add_normalised_errors(
    errors: NormalisedErrors,
    drive: wheel_drives.WheelDrive,
    calibration: WheelCalibration,
    receiver: Receiver,
) -> None:
    """Add the errors of the observable parameters in units of their sigma."""
    for name, effects in calibration.nodes.items():
        for (effect, parameter), truth in TRUTH_OF.items():
            if parameter in effects.get(effect, {}):
                estimate = effects[effect][parameter]
                errors[f"{effect}.{parameter}"].append(
                    (estimate.value - drive.nodes[name].truth[truth]) / estimate.sigma
                )
    if "track_width" in calibration.vehicle:
        estimate = calibration.vehicle["track_width"]["error"]
        errors["track_width.error"].append(
            (estimate.value - drive.nodes["left"].truth["track"]) / estimate.sigma
        )
    for estimate, value in zip(calibration.antenna, receiver.antenna, strict=True):
        errors["antenna"].append((estimate.value - value) / estimate.sigma)


if __name__ == "__main__":
    sys.exit(main())
