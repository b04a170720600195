"""Generate the files that the examples of the documentation use."""

from pathlib import Path

from in_process import hubodo
from vehicles import FROM_REFERENCE, LOW_INPUT_NOISE, model_toml, vehicle_toml

MODEL = model_toml(0.165, 0.55, gyro_noise=0.002, accel_noise=0.02, inputs=FROM_REFERENCE + LOW_INPUT_NOISE)
VEHICLE = vehicle_toml(0.165, 0.55)
CAMBER = "\n[nodes.left.effects.wheel_camber]\nangle = 0.05\n"


def write_example_files(folder: Path) -> Path:
    """Write model.toml, vehicle.toml, drive.mcap with a cambered left wheel, and night.mcap."""
    (folder / "model.toml").write_text(MODEL)
    (folder / "vehicle.toml").write_text(VEHICLE)
    (folder / "leaning.toml").write_text(MODEL + CAMBER)
    for words in (
        ("model.toml", "--duration", 60, "--seed", 7, "-o", "drive.mcap"),
        ("model.toml", "--drive", "rest", "--duration", 600, "-o", "night.mcap"),
    ):
        done = hubodo("simulate", folder / words[0], *words[1:-1], folder / words[-1])
        assert done.code == 0, done.err
    return folder
