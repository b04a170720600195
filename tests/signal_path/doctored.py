"""`hubodo doctor` on an emulated board, with a file system as written by `hubodo flash`."""

import contextlib
import json
import shutil
import time
from pathlib import Path

from hubodo.cli import main
from hubodo.emulator.board.settings import Clock, Flash
from hubodo.emulator.chips.faults import BrownOut
from hubodo.emulator.motion import StillMotion
from hubodo.emulator.virtual_node import VirtualNode
from hubodo.flash.check_result import CHECKS
from hubodo.flash.image import build_image, firmware_folder
from hubodo.flash.slots import MAIN, main_for_slot
from virtual_runs import micropython_or_skip


def doctor(capfd, port, *words):
    """Return the exit code and {name: (verdict, observation, remedy)}."""
    micropython_or_skip()
    code = main(["doctor", str(port), "--json", "--seconds", "3", *words])
    out, err = capfd.readouterr()
    assert out, err
    result = json.loads(out.splitlines()[-1])
    assert [row["name"] for row in result["checks"]] == list(CHECKS)
    assert result["ok"] == (code == 0)
    return code, {row["name"]: (row["verdict"], row["seen"], row["remedy"]) for row in result["checks"]}


def wrongs(checks):
    return [check for check, (verdict, _, _) in checks.items() if verdict == "wrong"]


def lay_flashed(root):
    """Create a file system as written by `hubodo flash`."""
    for name, content in build_image(firmware_folder(), None).items():
        path = root / ("" if name == MAIN else "fw_a") / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(main_for_slot(content, "/fw_a") if name == MAIN else content)
    return root


@contextlib.contextmanager
def board(flashed, tmp_path, motion=None, **settings):
    """Yield a virtual board after its first output following each dip of its supply, which removes the port.

    Its clock is paced unless given: a busy computer loses samples of a real board.
    """
    settings = {"clock": Clock("paced")} | settings
    if flashed is not None:
        shutil.copytree(flashed, tmp_path / "flash", dirs_exist_ok=True)
    with VirtualNode(motion or StillMotion(), Flash(folder=tmp_path / "flash"), **settings) as node:
        dips = sum(isinstance(fault, BrownOut) for fault in settings.get("faults", ()))
        _wait_for(lambda: len(node.stats["resets"]) >= dips)
        bytes_before = _bytes_out(node) if dips else 0
        _wait_for(lambda: _bytes_out(node) > bytes_before and Path(node.port).exists())
        yield node


def _bytes_out(node):
    return node.stats["counts"].get("bytes_out", 0)


def _wait_for(condition):
    end = time.monotonic() + 300
    while not condition():
        assert time.monotonic() < end, "silent"
        time.sleep(0.02)
