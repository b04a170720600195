"""What `hubodo --help`, completion, `hubodo info` and `import hubodo` load: not what only others need."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from hubodo.log.recording_writer import write_recording
from hubodo.recording import Recording, Table

ROOT = Path(__file__).resolve().parents[2]
SLOW = {
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
SLOW |= {"uvicorn", "websockets", "prometheus_client", "foxglove"}
LOADED = """
import json, sys
from hubodo.cli import main
said = []
for words in (["--help"], ["completion", "bash"], ["info", sys.argv[1]]):
    main(words)
    said.append(sorted({name.partition(".")[0] for name in sys.modules}))
print(json.dumps(said))
"""
IMPORTED = """
import json, sys
import hubodo
said = [sorted(sys.modules)]
log = hubodo.open(sys.argv[1])
print(json.dumps([*said, sorted({name.partition(".")[0] for name in sys.modules})]))
"""


def small_log(folder):
    t = np.arange(0.0, 1.0, 0.01)
    node = {name: np.zeros(len(t)) for name in ("gx", "gy", "gz", "ax", "ay", "az")}
    write_recording(Recording(nodes={"left": Table({"t": t, **node})}), folder / "a.mcap")
    return folder / "a.mcap"


def loaded(script, log):
    environment = {**os.environ, "PYTHONPATH": f"{ROOT / 'host'}:{ROOT / 'protocol'}"}
    command = [sys.executable, "-c", script, str(log)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return done.stdout, [set(names) for names in json.loads(done.stdout.splitlines()[-1])]


def test_help_completion_and_info_load_nothing_that_is_slow(tmp_path):
    said, (help_, completion, info) = loaded(LOADED, small_log(tmp_path))
    assert "/left/imu" in said
    assert not help_ & (SLOW | {"numpy", "mcap", "zstandard", "argcomplete", "tomllib"})
    assert not completion & (SLOW | {"numpy", "mcap"})
    assert not info & SLOW


def test_import_loads_nothing_and_open_what_reading_takes(tmp_path):
    _, (imported, opened) = loaded(IMPORTED, small_log(tmp_path))
    assert {name for name in imported if name.startswith("hubodo")} == {"hubodo", "hubodo.version"}
    assert "numpy" not in imported
    assert not opened & (SLOW | {"pandas"}) and "numpy" in opened


PARTS = """
import json, sys
import hubodo.verbs.flash
said = [sorted(sys.modules)]
import hubodo.verbs.fuse, hubodo.verbs.play, hubodo.verbs.record
print(json.dumps([*said, sorted(sys.modules)]))
"""


def test_commands_that_know_effects_load_nothing_that_they_seldom_need(tmp_path):
    _, (flash, driving) = loaded(PARTS, tmp_path)
    assert "hubodo.effects" in flash and "scipy" not in flash
    seldom = {
        f"scipy.{part}" for part in ("interpolate", "optimize", "signal", "spatial", "special", "stats")
    }
    assert "scipy.linalg" in driving and not driving & (seldom | {"pyproj"})
