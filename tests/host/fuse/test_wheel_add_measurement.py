"""The recipe "add a measurement" of CONTRIBUTING.md, carried out in a copy of the package."""

import io
import json
import shutil
from contextlib import redirect_stdout

import pytest

from package_copy import ROOT, PackageCopy

TESTS_OF_ROWS = (
    "host/fuse/test_wheel_measurements.py",
    "host/fuse/test_wheel_measurement_update.py",
    "host/fuse/test_wheel_mode.py",
)
"""Tests that differentiate every measurement, and tests that count rows."""
RUNS = """
import json
from dataclasses import replace
from hubodo.fuse.wheel.filter import WheelFilter
from hubodo.fuse.wheel.preintegration import WheelSample
from hubodo.fuse.wheel.measurements import MEASUREMENTS
from hubodo.fuse.wheel.motion_state import MotionState
from wheel_runs import config, short_loop

def first_seconds(node):
    part = node.t < 20.0
    return replace(node, t=node.t[part], gyro=node.gyro[part], accel=node.accel[part])

drive = short_loop(3)
result = {"rows": len(MEASUREMENTS)}
for names in (("left",), ("left", "right")):
    nodes = {name: first_seconds(drive.nodes[name]) for name in names}
    bulk, live = WheelFilter(config(drive, names)), WheelFilter(config(drive, names))
    bulk_poses = [*bulk.handle_blocks({n: (it.t, it.gyro, it.accel) for n, it in nodes.items()}).poses]
    samples = [
        WheelSample(name, t, tuple(gyro), tuple(accel))
        for name, node in nodes.items()
        for t, gyro, accel in zip(node.t.tolist(), node.gyro.tolist(), node.accel.tolist())
    ]
    live_poses = []
    for sample in sorted(samples, key=lambda sample: sample.t):
        live_poses += live.handle(sample).poses
    bulk_poses += bulk.finish().poses
    live_poses += live.finish().poses
    moving = [pose for pose in bulk_poses if pose.motion_state is MotionState.MOVING]
    result[len(names)] = {
        "nis": sum(pose.nis for pose in moving),
        "dof": max(pose.dof for pose in moving),
        "live": [[pose.x.hex(), pose.y.hex(), pose.covariance.tobytes().hex()] for pose in live_poses],
        "bulk": [[pose.x.hex(), pose.y.hex(), pose.covariance.tobytes().hex()] for pose in bulk_poses],
    }
print(json.dumps(result))
"""


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> PackageCopy:
    """Return a copy of the package with the example measurement added by one file and one line."""
    copy = PackageCopy(tmp_path_factory.mktemp("copy"))
    measurements = copy.package / "fuse/wheel/measurements"
    shutil.copy(ROOT / "tests/example_measurement.py", measurements / "vertical.py")
    copy.replace(
        "fuse/wheel/measurements/__init__.py",
        ("(yaw, roll, forward, sideways)", "(yaw, roll, forward, sideways, vertical)"),
        (
            "import forward, roll, rolling, sideways, yaw",
            "import forward, roll, rolling, sideways, vertical, yaw",
        ),
    )
    return copy


def test_an_added_measurement_counts_in_nis_and_dof_and_live_stays_equal_to_bulk(
    copy: PackageCopy,
) -> None:
    with redirect_stdout(io.StringIO()) as printed:
        exec(RUNS, {})  # here, with the original package
    before = json.loads(printed.getvalue())
    after = json.loads(copy.run("-c", RUNS))
    assert after["rows"] == before["rows"] + 1
    for wheels in (1, 2):
        run, reference = after[str(wheels)], before[str(wheels)]
        assert run["dof"] == reference["dof"] + wheels
        assert run["nis"] != reference["nis"]
        assert run["bulk"] == run["live"]
        assert run["bulk"] != reference["bulk"]


@pytest.mark.repeat
def test_the_tests_of_measurements_cover_an_added_one_and_pass(
    copy: PackageCopy,
) -> None:
    passed = copy.run_tests(*TESTS_OF_ROWS)
    # Two sides, two facings, four seeds.
    assert sum("vertical" in name for name in passed) == 16
