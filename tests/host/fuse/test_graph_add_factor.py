"""The recipe "add a factor" of CONTRIBUTING.md, carried out in a copy of the package."""

import shutil

import pytest

from package_copy import ROOT, PackageCopy

GUARDS = (
    "host/fuse/test_graph_factors.py",
    "host/fuse/test_graph_build.py",
    "host/fuse/test_graph_constants.py",
    "host/fuse/test_track.py",
    "host/api/test_public_names.py",
)
"""Tests of the parts of the package that a new factor touches."""
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


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> PackageCopy:
    """Return a copy of the package with the example factor added."""
    copy = PackageCopy(tmp_path_factory.mktemp("copy"))
    shutil.copy(ROOT / "tests/example_factor.py", copy.package / "fuse/graph/factors/gate.py")
    copy.add_lines(
        "fuse/fusion.py",
        ('    "heading": Headings.from_table,', '    "gate": Gates.from_table,'),
        (
            "from hubodo.fuse.graph.factors.heading import Headings",
            "from hubodo.fuse.graph.factors.gate import Gates",
        ),
    )
    copy.add_lines(
        "recording.py",
        ("    heading: Table | None = None", "    gate: Table | None = None"),
        ('    "heading": (("t", "heading"), ("sigma",)),', '    "gate": (("t", "north"), ()),'),
    )
    return copy


def test_a_factor_added_by_the_recipe_is_fused_and_reported(copy: PackageCopy) -> None:
    assert "gate: passed 2 times" in copy.run("-c", FUSE_WITH_GATE)


@pytest.mark.repeat
def test_the_tests_of_the_touched_parts_pass_with_an_added_factor(copy: PackageCopy) -> None:
    assert copy.run_tests(*GUARDS)
