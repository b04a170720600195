"""What `pip install hubodo` brings: the firmware is in it, to flash and simulate without a checkout."""

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from hubodo.flash.image import firmware_folder, sources

ROOT = Path(__file__).resolve().parents[2]
MODEL = """
[vehicle]
wheel_radius = 0.165
track_width = 0.55
[imu]
gyro_noise = 0.002
accel_noise = 0.02
[nodes.left]
side = "left"
facing = "left"
[inputs]
speed = "reference.speed"
yaw_rate = "reference.yaw_rate"
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """A folder with what the wheel of this tree holds."""
    tree = tmp_path_factory.mktemp("tree")
    for name in ("host", "protocol", "firmware"):
        ignored = shutil.ignore_patterns("__pycache__", "*.egg-info", "images")
        shutil.copytree(ROOT / name, tree / name, ignore=ignored)
    for name in ("pyproject.toml", "setup.py", "MANIFEST.in", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, tree)
    build = "from setuptools import build_meta; print(build_meta.build_wheel('dist'))"
    subprocess.run([sys.executable, "-c", build], cwd=tree, check=True, capture_output=True)
    (wheel,) = (tree / "dist").glob("*.whl")
    site = tmp_path_factory.mktemp("site")
    zipfile.ZipFile(wheel).extractall(site)
    return site


def run(site, folder, *words):
    environment = dict(os.environ, PYTHONPATH=str(site), OPENBLAS_NUM_THREADS="1")
    command = [sys.executable, *words]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=120)


def test_an_installed_package_holds_the_firmware_file_by_file(installed, tmp_path):
    said = run(
        installed, tmp_path, "-c", "from hubodo.flash.image import firmware_folder; print(firmware_folder())"
    )
    folder = Path(said.stdout.strip())
    assert folder == installed / "hubodo" / "firmware", said.stderr
    assert sources(folder) == sources(firmware_folder())


def test_an_installed_package_flashes_and_runs_virtual_nodes_from_any_folder(installed, tmp_path):
    (tmp_path / "model.toml").write_text(MODEL)
    said = run(installed, tmp_path, "-m", "hubodo.cli", "flash", "--help")
    assert said.returncode == 0 and "--roll-back" in said.stdout, said.stderr
    words = ("simulate", "model.toml", "--virtual-node", "--interpreter", "cpython", "--duration", "8")
    said = run(installed, tmp_path, "-m", "hubodo.cli", *words, "--rate", "104", "-o", "drive.mcap")
    assert said.returncode == 0, said.stderr
    assert (tmp_path / "drive.mcap").stat().st_size > 10_000
