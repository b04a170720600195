"""Start-up: `hubodo --help`, completion, `hubodo info` and `import hubodo` load no slow package."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from hubodo.log.recording_writer import write_recording
from hubodo.recording import Recording, Table

ROOT = Path(__file__).resolve().parents[3]
SLOW_PACKAGES = {
    "matplotlib",
    "plotly",
    "scipy",
    "pyproj",
    "h5py",
    "rosbags",
    "pyarrow",
    "gtsam",
    "serial",
    "starlette",
}
SLOW_PACKAGES |= {"uvicorn", "websockets", "prometheus_client", "foxglove"}
PACKAGES_OF_COMMANDS = """
import json, sys
from hubodo.cli import main
loaded = []
for arguments in (["--help"], ["completion", "bash"], ["info", sys.argv[1]]):
    main(arguments)
    loaded.append(sorted({name.partition(".")[0] for name in sys.modules}))
print(json.dumps(loaded))
"""
PACKAGES_OF_IMPORT = """
import json, sys
import hubodo
loaded = [sorted(sys.modules)]
log = hubodo.open(sys.argv[1])
print(json.dumps([*loaded, sorted({name.partition(".")[0] for name in sys.modules})]))
"""


def small_log(folder):
    t = np.arange(0.0, 1.0, 0.01)
    node = {name: np.zeros(len(t)) for name in ("gx", "gy", "gz", "ax", "ay", "az")}
    write_recording(Recording(nodes={"left": Table({"t": t, **node})}), folder / "a.mcap")
    return folder / "a.mcap"


def loaded_modules(script, log):
    environment = {**os.environ, "PYTHONPATH": f"{ROOT / 'host'}:{ROOT / 'protocol'}"}
    command = [sys.executable, "-c", script, str(log)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return done.stdout, [set(names) for names in json.loads(done.stdout.splitlines()[-1])]


def test_help_completion_and_info_load_no_slow_package(tmp_path):
    output, (help_, completion, info) = loaded_modules(PACKAGES_OF_COMMANDS, small_log(tmp_path))
    assert "/left/imu" in output
    assert not help_ & (SLOW_PACKAGES | {"numpy", "mcap", "zstandard", "argcomplete", "tomllib"})
    assert not completion & (SLOW_PACKAGES | {"numpy", "mcap"})
    assert not info & SLOW_PACKAGES


def test_import_loads_nothing_and_open_loads_only_what_reading_needs(tmp_path):
    _, (imported, opened) = loaded_modules(PACKAGES_OF_IMPORT, small_log(tmp_path))
    assert {name for name in imported if name.startswith("hubodo")} == {"hubodo", "hubodo.version"}
    assert "numpy" not in imported
    assert not opened & (SLOW_PACKAGES | {"pandas"}) and "numpy" in opened


MODULES_OF_VERBS = """
import json, sys
import hubodo.verbs.flash
loaded = [sorted(sys.modules)]
import hubodo.verbs.fuse, hubodo.verbs.play, hubodo.verbs.record
loaded.append(sorted(sys.modules))
import hubodo.verbs.gap, hubodo.verbs.north
print(json.dumps([*loaded, sorted(sys.modules)]))
"""


def test_verbs_do_not_load_the_parts_of_scipy_that_they_seldom_need(tmp_path):
    _, (flash, driving, gap) = loaded_modules(MODULES_OF_VERBS, tmp_path)
    assert "hubodo.effects" in flash and "scipy" not in flash
    seldom = {
        f"scipy.{part}" for part in ("interpolate", "optimize", "signal", "spatial", "special", "stats")
    }
    assert "scipy.linalg" in driving and not driving & (seldom | {"pyproj"})
    assert "scipy.interpolate" in gap and not gap & {"scipy.signal", "scipy.stats"}
