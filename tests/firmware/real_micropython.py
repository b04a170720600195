"""Run Python in real MicroPython under Node.js, with the firmware and a fake port in its file system."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import wanted

ROOT = Path(__file__).parents[2]
FAKES = ROOT / "tests" / "fakes"
LIMIT_S = 150


def node_or_skip():
    """Return the path of Node.js; skip the test without it or the MicroPython package; see `wanted`."""
    node = shutil.which("node", path=f"{ROOT / '.venv/bin'}{os.pathsep}{os.environ.get('PATH', '')}")
    package = ROOT / "node_modules" / "@micropython"
    if not (node and package.exists()):
        missing = "node" if not node else "node_modules/@micropython"
        wanted.lacking(f"{missing} is missing: run make setup where the npm registry can be reached")
    return node


def board_files():
    """Return (path on the board, path here) of the firmware and the fake port."""
    firmware = ROOT / "firmware"
    files = [(f"/{p.relative_to(firmware).as_posix()}", str(p)) for p in sorted(firmware.rglob("*.py"))]
    return files + [(f"/{p.name}", str(p)) for p in sorted((FAKES / "micropython").glob("*.py"))]


def run(tmp_path, *pieces):
    """Run pieces of code; return the content of /result and the bytes on stdout."""
    node = node_or_skip()
    # Node.js searches modules from the folder of the script, which must contain node_modules.
    job, out = tmp_path / "job.json", tmp_path / "stdout"
    files = [(there, here) for there, here in board_files() if there != "/main.py"]
    job.write_text(json.dumps({"files": files, "run": pieces, "out": str(out)}))
    done = subprocess.run(
        [node, str(FAKES / "run_micropython.mjs"), str(job)],
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    printed = out.read_bytes() if out.exists() else b""
    assert done.returncode == 0, f"{done.stderr[-2000:]}\n{printed[-2000:]!r}"
    return json.loads(done.stdout), printed
