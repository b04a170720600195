"""The recipe of CONTRIBUTING.md for a new effect, one class and one line, in a copy of the package."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import hubodo

EFFECT = '''"""A made-up effect: the accelerometer reads a third harmonic of the wheel angle."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hubodo.effects.base import Effect, Level, SensorChain, parameter


@dataclass(frozen=True)
class ThirdHarmonic(Effect):
    """The x accelerometer reads a cosine of three times the wheel angle."""

    name: ClassVar[str] = "third_harmonic"
    level: ClassVar[Level] = "wheel"
    meaning: ClassVar[str] = "the accelerometer reads a third harmonic"
    amplitude: float = parameter("m/s²", 0.1)

    def add_offsets(self, chain: SensorChain) -> None:
        chain.accel[0] += self.amplitude * np.cos(3.0 * chain.angle)
'''

MODEL = """[vehicle]
wheel_radius = 0.165
track_width = 0.55
[imu]
gyro_noise = 0.002
accel_noise = 0.05
[nodes.left]
side = "left"
facing = "left"
[nodes.right]
side = "right"
facing = "left"
[inputs]
speed = "reference.speed"
yaw_rate = "reference.yaw_rate"
"""

HIDDEN = "[nodes.left.effects.third_harmonic]\namplitude = 0.1\n"


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """Return a folder with a copy of the package to which the effect was added by the recipe."""
    folder = tmp_path_factory.mktemp("package")
    source = Path(hubodo.__file__).parent
    shutil.copytree(source, folder / "hubodo", ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "hubodo" / "effects" / "third_harmonic.py").write_text(EFFECT, "utf-8")
    listing = folder / "hubodo" / "effects" / "__init__.py"
    text = listing.read_text("utf-8")
    text = text.replace(
        "\nEFFECTS:", "from hubodo.effects.third_harmonic import ThirdHarmonic\n\nEFFECTS:", 1
    ).replace("    GyroBias,\n    GyroWarmup,\n", "    GyroBias,\n    ThirdHarmonic,\n    GyroWarmup,\n", 1)
    listing.write_text(text, "utf-8")
    return folder


def run_verb(package, *arguments):
    """Run a verb of the copied package and return its output."""
    code = "import sys, hubodo.cli; sys.exit(hubodo.cli.main(sys.argv[1:]))"
    command = [sys.executable, "-c", code, *map(str, arguments)]
    environment = {**os.environ, "PYTHONPATH": str(package)}
    process = subprocess.run(
        command, env=environment, capture_output=True, text=True, cwd=package, timeout=120
    )
    assert process.returncode == 0, process.stderr
    return process.stdout


def test_one_class_and_one_line_suffice_to_simulate_an_effect_and_to_find_it(package, tmp_path):
    (tmp_path / "true.toml").write_text(MODEL + HIDDEN, "utf-8")
    (tmp_path / "model.toml").write_text(MODEL, "utf-8")
    run_verb(
        package,
        "simulate",
        tmp_path / "true.toml",
        "--duration",
        25,
        "--seed",
        2,
        "-o",
        tmp_path / "log.mcap",
    )
    run_verb(package, "gap", tmp_path / "model.toml", tmp_path / "log.mcap", "-o", tmp_path / "gap")
    (finding,) = json.loads((tmp_path / "gap" / "gap.json").read_text("utf-8"))["found"]
    assert (finding["effect"], finding["scope"]) == ("third_harmonic", "left")
    amplitude = finding["parameters"]["amplitude"]
    assert amplitude["value"] == pytest.approx(0.1, abs=4.0 * amplitude["sigma"])
    assert "third_harmonic" in (tmp_path / "gap" / "model.toml").read_text("utf-8")
