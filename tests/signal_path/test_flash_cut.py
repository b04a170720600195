"""A node that loses power or its host during flashing runs the complete old or the complete new firmware."""

import ast
import base64
import json
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import hubowire
from hubodo.cli import main
from hubodo.emulator.board.settings import Clock, Flash, Host
from hubodo.emulator.motion import StillMotion
from hubodo.emulator.virtual_node import VirtualNode
from hubodo.flash.image import build_image
from hubodo.flash.slots import MAIN
from hubowire.messages import Hello
from repetitions import first_and_more
from slot_layouts import firmware, lay


@pytest.fixture(scope="module")
def firmwares(tmp_path_factory):
    """Create an old and a new firmware; return their folders and the old files as stored on a node."""
    root = tmp_path_factory.mktemp("firmware")
    old, new = firmware(root / "old", "old"), firmware(root / "new", "new")
    return old, new, build_image(old, None)


def apply(change, root):
    """Apply one line of the journal to a copy of the file system."""
    path = root / change["path"].lstrip("/")
    match change["what"]:
        case "write":
            path.write_bytes(base64.b64decode(change["base64"]))
        case "rename":
            path.replace(root / change["to"].lstrip("/"))
        case "unlink":
            path.unlink()
        case "mkdir":
            path.mkdir()
        case "rmdir":
            path.rmdir()


def comes_up_as(flash):
    """Return the firmware that a board with this file system runs after power-on; check its Hello."""
    node = VirtualNode(
        StillMotion(),
        Flash(folder=flash),
        clock=Clock("stepped", run_for=0.6),
        host=Host("memory"),
        own_process=False,
    )
    with node:
        node.wait(60)
        output, prompts = node.output, node.stats["counts"].get("at_prompt", 0)
    hellos = [f for f in hubowire.FrameDecoder().feed(output) if f.type_id == Hello.type_id]
    assert hellos and not prompts, output[-600:]
    (builds,) = re.findall(rb"builds (\[[^\]]*\])", output)
    return ast.literal_eval(builds.decode())


def flash(port, new, monkeypatch, capfd, *words):
    import hubodo.verbs.flash as verb

    monkeypatch.setattr(verb, "firmware_folder", lambda: new)
    code = main(["flash", str(port), "--json", *words])
    out, err = capfd.readouterr()
    assert code == 0, err
    return json.loads(out.splitlines()[-1])


@pytest.mark.parametrize("slot", first_and_more("/fw_b", ""))
def test_power_lost_at_any_moment_leaves_the_old_or_the_new_firmware(
    firmwares, slot, tmp_path, monkeypatch, capfd
):
    """Apply the changes of flashing one by one; then power on the board."""
    _, new, image = firmwares
    before, journal = tmp_path / "before", tmp_path / "journal"
    lay(image, before, slot)
    (before / "config.json").write_text('{"node_id": 1}')
    shutil.copytree(before, tmp_path / "flash")
    with VirtualNode(StillMotion(), Flash(folder=tmp_path / "flash", journal=journal)) as node:
        report = flash(node.port, new, monkeypatch, capfd, "--node", "right")
    assert report["node"] == 2
    changes = [json.loads(line) for line in journal.read_text().splitlines()]
    switch = next(k for k, c in enumerate(changes) if c.get("to") == f"/{MAIN}")
    assert any(change["path"] == "/stay_in_repl" for change in changes)
    ran, tried = [], [*range(0, switch - 3, 14), *range(switch - 3, switch + 3), len(changes) - 1]
    for k, change in enumerate(changes):
        apply(change, before)
        if k in tried:
            shutil.copytree(before, tmp_path / f"cut{k}")
            ran.append((k, comes_up_as(tmp_path / f"cut{k}")))
    print(f"{len(changes)} changes, {len(ran)} of them followed by power-on, the switch is number {switch}")
    assert [builds for k, builds in ran] == [["old"] if k < switch else ["new"] for k, _ in ran]

    half = tmp_path / f"cut{tried[len(tried) // 2]}"
    with VirtualNode(StillMotion(), Flash(folder=half)) as node:
        flash(node.port, new, monkeypatch, capfd)
    assert comes_up_as(half) == ["new"]


# A host killed after sending the first piece of its tenth file.
DYING = """
import os, signal, sys
from pathlib import Path
import hubodo.flash.board as board, hubodo.verbs.flash as verb
from hubodo.cli import main

files, pieces = [], board._pieces

def dying(content):
    files.append(content)
    for k, piece in enumerate(pieces(content)):
        if len(files) == 10 and k == 1:
            os.kill(os.getpid(), signal.SIGKILL)
        yield piece

board._pieces = dying
verb.firmware_folder = lambda: Path(sys.argv[2])
main(["flash", sys.argv[1]])
"""


def test_a_host_that_dies_while_it_copies_leaves_the_old_firmware(firmwares, tmp_path, monkeypatch, capfd):
    """The board waits for the rest of a file and is flashed again without a restart."""
    _, new, image = firmwares
    lay(image, tmp_path / "flash", "/fw_a")
    with VirtualNode(StillMotion(), Flash(folder=tmp_path / "flash")) as node:
        host = subprocess.run([sys.executable, "-c", DYING, str(node.port), str(new)], check=False)
        assert host.returncode == -signal.SIGKILL
        shutil.copytree(tmp_path / "flash", tmp_path / "cut")
        report = flash(node.port, new, monkeypatch, capfd)
    copied = len(list((tmp_path / "cut").glob("fw_b/**/*.mpy")))
    assert copied == 9
    assert comes_up_as(tmp_path / "cut") == ["old"]
    assert len(report["copied"]) == len(image) + 1 - copied, "what was there already is not sent again"
    assert comes_up_as(tmp_path / "flash") == ["new"]


def test_if_a_slot_does_not_load_the_other_one_runs(firmwares, tmp_path):
    """One file is incompatible with this MicroPython, one is missing; nothing of that slot is used."""
    _, new, image = firmwares
    fresh = build_image(new, None)
    for name, content in (("outbox.mpy", b"M\x05\x00\x1f"), ("drivers/lis3mdl.mpy", None)):
        root = tmp_path / Path(name).stem
        lay(fresh, root, "/fw_b")
        lay({key: value for key, value in image.items() if key != MAIN}, root, "/fw_a")
        path = root / "fw_b" / name
        path.unlink() if content is None else path.write_bytes(content)
        assert comes_up_as(root) == ["old"]
