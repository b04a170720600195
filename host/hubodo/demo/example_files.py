"""The files that the documents use: a vehicle, models, a calibration, a drive and a night at standstill."""

from __future__ import annotations

from pathlib import Path

from hubodo.atomic_files import write_atomically
from hubodo.calibration.file import parse_calibration
from hubodo.log.recording_writer import write_recording
from hubodo.model import experiments
from hubodo.model.model_file import read_model
from hubodo.progress_callback import Progress

_SEED = 7
_RATE_HZ = 200.0
_REFERENCE_RATE_HZ = 50.0
_DRIVE_S, _NIGHT_S = 60.0, 600.0

VEHICLE = """\
[vehicle]
wheel_radius = 0.165     # m
track_width = 0.55       # m, between the contact points

[nodes.left]
side = "left"            # which wheel
facing = "left"          # where its z axis points
[nodes.right]
side = "right"
facing = "left"
"""
_SENSORS_AND_INPUTS = """
[imu]                    # 1σ per sample
gyro_noise = 0.002       # rad/s
accel_noise = 0.02       # m/s²

[inputs]                 # what drives the wheels
speed = "reference.speed"
yaw_rate = "reference.yaw_rate"
speed_noise = 0.0005
yaw_rate_noise = 0.0002
"""
MODEL = VEHICLE + _SENSORS_AND_INPUTS
LEANING = (
    MODEL
    + """
[nodes.left.effects.wheel_camber]
angle = 0.05             # rad; model.toml lacks it, and `hubodo gap` finds it
"""
)
BENCH = f"""\
# One node on a bench, turned by hand through static poses.
[vehicle]
wheel_radius = 0.165
track_width = 0.55

[nodes.left]
side = "left"
facing = "left"
{_SENSORS_AND_INPUTS}"""
CALIBRATION = """\
# Errors of the node on the bench: `simulate --calibration` adds them, `calibrate imu` estimates them again.
[nodes.left.effects.gyro_bias]
method = "example"
source_sha256 = ""
date = "2026-01-01"
x = { value = 0.01, sigma = 0.0001 }
y = { value = -0.004, sigma = 0.0001 }
z = { value = 0.002, sigma = 0.0001 }

[nodes.left.effects.accel_bias]
method = "example"
source_sha256 = ""
date = "2026-01-01"
x = { value = 0.12, sigma = 0.002 }
y = { value = -0.08, sigma = 0.002 }
z = { value = 0.2, sigma = 0.002 }
"""
TEXTS = {
    "vehicle.toml": VEHICLE,
    "model.toml": MODEL,
    "leaning.toml": LEANING,
    "bench.toml": BENCH,
    "c.toml": CALIBRATION,
}
LOGS = {"drive.mcap": ("random", _DRIVE_S), "night.mcap": ("rest", _NIGHT_S)}
"""Simulated logs: the kind of drive and its duration."""


def write_example_files(folder: Path, report_progress: Progress) -> list[str]:
    """Write all files into an existing folder, replacing those of the same names; return their names."""
    for name, text in TEXTS.items():
        write_atomically(folder / name, text)
    parse_calibration(CALIBRATION, folder / "c.toml")
    model = read_model(folder / "model.toml")
    for number, (name, (kind, duration)) in enumerate(LOGS.items()):
        report_progress(f"simulating {name}", number / len(LOGS))
        experiment = experiments.make_experiment(kind, model, duration, _SEED)
        recording = experiments.simulate(model, experiment, _RATE_HZ, _REFERENCE_RATE_HZ, _SEED)
        recording = experiments.with_simulation_metadata(recording, kind, model, _SEED)
        (folder / name).unlink(missing_ok=True)
        write_recording(recording, folder / name, vehicle=model.vehicle)
    return [*TEXTS, *LOGS]
