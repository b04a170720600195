"""Drives of a real car, the model of its geometry and noise, and the largest error of an injected value."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

import wanted  # noqa: E402
from hubodo.log.csv_folder import read_folder  # noqa: E402
from hubodo.recording import Recording  # noqa: E402
from vehicles import model_toml  # noqa: E402

CAR = model_toml(
    0.2924,
    1.42,
    gyro_noise=0.025,
    accel_noise=1.2,
    inputs='speed = "nodes"\nyaw_rate = "frame.gz"\n',
    facing={"left": "left", "right": "right"},
)
# Largest accepted error of a value: share of the injected size, or number of sigmas.
MAX_ERROR_SHARE, MAX_ERROR_SIGMA = 0.25, 3.0


def read_drive(name: str) -> Recording:
    """Return a recording of the car."""
    return read_folder(wanted.recording("car") / name)
