"""The recipe "add a factor" of CONTRIBUTING.md, carried out in a copy of the package."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
GUARDS = (
    "host/fuse/test_graph_factors.py",
    "host/fuse/test_graph_build.py",
    "host/fuse/test_graph_constants.py",
    "host/fuse/test_track.py",
    "host/api/test_public_names.py",
)
"""Tests of the rooms that a new factor touches."""
FUSE_WITH_GATE = """
import numpy as np
from graph_drives import wiggly_path
from hubodo.fuse import fusion
from hubodo.fuse.wheel_odometry import WheelOdometry
from hubodo.recording import Recording, Table

path = wiggly_path(np.random.default_rng(51))
gates = Table({"t": [4.05, 11.0], "north": [1.0, 2.5]})
result = fusion.fuse_outside_sensors(Recording({}, gate=gates), WheelOdometry(path, (), "", {}))
print(*result.warnings)
"""


def add_lines(path, **lines):
    """Add a line after the line of a file that contains `anchor`."""
    text = path.read_text("utf-8")
    for anchor, line in lines.values():
        assert text.count(anchor) == 1, anchor
        text = text.replace(anchor, f"{anchor}\n{line}")
    path.write_text(text, "utf-8")


@pytest.fixture(scope="module")
def environment(tmp_path_factory):
    """An environment in which `hubodo` is a copy of the package with the example factor added."""
    package = tmp_path_factory.mktemp("copy") / "hubodo"
    shutil.copytree(ROOT / "host/hubodo", package, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "tests/example_factor.py", package / "fuse/graph/factors/gate.py")
    add_lines(
        package / "fuse/fusion.py",
        table=('    "heading": Headings.from_table,', '    "gate": Gates.from_table,'),
        imports=(
            "from hubodo.fuse.graph.factors.heading import Headings",
            "from hubodo.fuse.graph.factors.gate import Gates",
        ),
    )
    add_lines(
        package / "recording.py",
        field=("    heading: Table | None = None", "    gate: Table | None = None"),
        columns=('    "heading": (("t", "heading"), ("sigma",)),', '    "gate": (("t", "north"), ()),'),
    )
    path = os.pathsep.join(str(folder) for folder in (package.parent, ROOT / "protocol", ROOT / "tests"))
    return {**os.environ, "PYTHONPATH": path}


def run_python(environment, *arguments):
    command = [sys.executable, *arguments]
    return subprocess.run(command, cwd=ROOT / "tests", env=environment, capture_output=True, text=True)


def test_a_factor_added_by_the_recipe_is_fused_and_reported(environment):
    completed = run_python(environment, "-c", FUSE_WITH_GATE)
    assert "gate: passed 2 times" in completed.stdout, completed.stderr


def test_no_test_of_the_rooms_fails_for_an_added_factor(environment):
    completed = run_python(
        environment, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", *GUARDS
    )
    assert completed.returncode == 0, completed.stdout
