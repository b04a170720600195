"""A ride with effects hidden below the registers of both chips: what is hidden, and the ride begun."""

import subprocess
import sys

CAMBER, LIMIT = 0.15, 9.5
# The least that the search for effects accepts, and a little.
SECONDS, SEED = 22.0, 2
RIGHT = """
[vehicle]
wheel_radius = 0.165
track_width = 0.55
[imu]
gyro_noise = 0.002
accel_noise = 0.02
[inputs]
speed_noise = 0.001
clock_sigma = 0.005
[nodes.right]
side = "right"
facing = "left"
"""
MODEL = f"""{RIGHT}
[nodes.left]
side = "left"
facing = "left"
[nodes.left.effects.wheel_camber]
angle = {CAMBER}
[nodes.left.effects.gyro_bias]
x = 0.03
[nodes.left.effects.outliers]
probability = 0.02
sigma = 60.0
[nodes.left.effects.accel_saturation]
limit = {LIMIT}
[nodes.right.effects.wheel_radius]
error = 0.05
"""


def begin(folder):
    """The process that drives, in real time, and leaves drive.mcap in the folder."""
    (folder / "model.toml").write_text(MODEL)
    words = ["simulate", "model.toml", "-o", "drive.mcap", "--virtual-node", "--json"]
    words += ["--duration", str(SECONDS), "--seed", str(SEED)]
    silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
    return subprocess.Popen([sys.executable, "-m", "hubodo", *words], cwd=folder, text=True, **silent)
