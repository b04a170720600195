"""What `hubodo --help`, the completion of a shell and `hubodo info` load: not what only others need."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from hubodo.log.convert import write_recording
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


def test_help_completion_and_info_load_nothing_that_is_slow(tmp_path):
    t = np.arange(0.0, 1.0, 0.01)
    node = {name: np.zeros(len(t)) for name in ("gx", "gy", "gz", "ax", "ay", "az")}
    write_recording(Recording(nodes={"left": Table({"t": t, **node})}), tmp_path / "a.mcap")
    environment = {**os.environ, "PYTHONPATH": f"{ROOT / 'host'}:{ROOT / 'protocol'}"}
    command = [sys.executable, "-c", LOADED, str(tmp_path / "a.mcap")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    help_, completion, info = (set(names) for names in json.loads(done.stdout.splitlines()[-1]))
    assert "/left/imu" in done.stdout
    assert not help_ & (SLOW | {"numpy", "mcap", "zstandard", "argcomplete", "tomllib"})
    assert not completion & (SLOW | {"numpy", "mcap"})
    assert not info & SLOW
