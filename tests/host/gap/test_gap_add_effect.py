"""The recipe of CONTRIBUTING.md for a new effect, one class and one line, in a copy of the package."""

import json
from pathlib import Path

import pytest

from package_copy import PackageCopy

EFFECT = '''"""A made-up effect: the accelerometer reads a third harmonic of the wheel angle."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hubodo.effects.base import Effect, Level, parameter
from hubodo.effects.sensor_chain import SensorChain


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
def package(tmp_path_factory: pytest.TempPathFactory) -> PackageCopy:
    """Return a copy of the package to which the effect was added by the recipe."""
    copy = PackageCopy(tmp_path_factory.mktemp("package"))
    (copy.package / "effects" / "third_harmonic.py").write_text(EFFECT, "utf-8")
    copy.replace(
        "effects/__init__.py",
        ("\nEFFECTS:", "from hubodo.effects.third_harmonic import ThirdHarmonic\n\nEFFECTS:"),
        ("    GyroBias,\n    GyroWarmup,\n", "    GyroBias,\n    ThirdHarmonic,\n    GyroWarmup,\n"),
    )
    return copy


def run_verb(package: PackageCopy, *arguments: object) -> str:
    """Run a verb of the copied package and return its output."""
    return package.run("-m", "hubodo", *arguments)


def test_one_class_and_one_line_suffice_to_simulate_an_effect_and_to_find_it(
    package: PackageCopy, tmp_path: Path
) -> None:
    (tmp_path / "true.toml").write_text(MODEL + HIDDEN, "utf-8")
    (tmp_path / "model.toml").write_text(MODEL, "utf-8")
    run_verb(
        package,
        "simulate",
        tmp_path / "true.toml",
        "--duration",
        25,
        "--rate",
        104,
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
