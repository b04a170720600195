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

# Both verbs in one process, which imports the package once.
SIMULATE_AND_SEARCH = """
import sys
from hubodo.cli import main
for words in sys.argv[1].splitlines():
    assert main(words.split()) == 0, words
"""


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


def test_one_class_and_one_line_suffice_to_simulate_an_effect_and_to_find_it(
    package: PackageCopy, tmp_path: Path
) -> None:
    (tmp_path / "true.toml").write_text(MODEL + HIDDEN, "utf-8")
    (tmp_path / "model.toml").write_text(MODEL, "utf-8")
    log, output = tmp_path / "log.mcap", tmp_path / "gap"
    verbs = [
        f"simulate {tmp_path / 'true.toml'} --duration 25 --rate 52 --seed 2 -o {log}",
        f"gap {tmp_path / 'model.toml'} {log} -o {output}",
    ]
    package.run("-c", SIMULATE_AND_SEARCH, "\n".join(verbs))
    (finding,) = json.loads((output / "gap.json").read_text("utf-8"))["found"]
    assert (finding["effect"], finding["scope"]) == ("third_harmonic", "left")
    amplitude = finding["parameters"]["amplitude"]
    assert amplitude["value"] == pytest.approx(0.1, abs=4.0 * amplitude["sigma"])
    assert "third_harmonic" in (output / "model.toml").read_text("utf-8")
