"""USB of the emulated Pico: firmware and host when the other side disconnects or does not read."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest
from board_programs import CHATTER, Terminal, firmware

from hubodo.emulator.board.settings import BoardSettings, Clock, Flash, Host
from hubodo.emulator.interpreters.rp2040.pico import PicoSettings
from hubodo.emulator.motion import StillMotion
from hubodo.emulator.virtual_node import VirtualNode
from virtual_runs import pico_or_skip

FLOOD = """
import sys, time
time.sleep_ms(600)
chunk = bytearray(256)
worst = 0
for _ in range(800):
    t = time.ticks_ms()
    sys.stdout.buffer.write(chunk)
    worst = max(worst, time.ticks_diff(time.ticks_ms(), t))
    if worst > 100: break
with open('/spent', 'w') as f: f.write(str(worst))
"""


@pytest.fixture(autouse=True)
def _needs_an_image():
    pico_or_skip()


PICO = BoardSettings(interpreter="rp2040", pico=PicoSettings(miss_cycles=0))


def pico(folder: Path, program: str) -> VirtualNode:
    """Return a board whose link follows real time."""
    flash = Flash(firmware(folder / "fw", main=program))
    return VirtualNode(StillMotion(), flash, board=PICO, clock=Clock("paced"), own_process=False)


def spent(folder: Path, host: Host) -> int:
    """Return the duration of the longest write of FLOOD, ms, by the board's own clock."""
    flash = Flash(firmware(folder / "fw", main=FLOOD))
    clock = Clock("stepped", run_for=4.0)
    with VirtualNode(StillMotion(), flash, board=PICO, clock=clock, host=host, own_process=False) as board:
        assert board.wait(60)
        return int((board.flash / "spent").read_text())


@pytest.mark.real_time
def test_a_host_that_unplugs_gets_a_new_terminal_and_the_program_continues(tmp_path: Path) -> None:
    with pico(tmp_path, CHATTER) as board:
        with Terminal(board.port) as host:
            host.until(b"000100\n")
            before = Path(board.port).readlink()
            board.unplug()
            assert not os.path.lexists(board.port)
            sent = board.stats["link"]["written"] // len(b"000000\n")
            time.sleep(0.3)
            board.replug()
            assert Path(board.port).readlink() != before
        with Terminal(board.port) as host:
            host.until(b"\n")
            lines = [int(line) for line in host.until(b"000400\n").split()]
        # The device's buffer holds what was sent meanwhile; data in transit to the host is lost.
        assert lines == list(range(lines[0], 401)) and sent - 2 <= lines[0] <= sent + 2
        assert board.stats["t"] < 2.0
        assert board.stats["resets"] == []


def test_a_host_that_holds_the_port_and_does_not_read_costs_each_packet_half_a_second(tmp_path: Path) -> None:
    assert spent(tmp_path, Host("memory", read_pauses=((0.0, 4.0),))) in range(450, 2100)


def test_with_the_port_closed_writes_cost_nothing(tmp_path: Path) -> None:
    assert spent(tmp_path, Host("pty")) < 20


@pytest.mark.real_time
def test_a_program_is_stopped_by_ctrl_c_and_the_prompt_answers(tmp_path: Path) -> None:
    with pico(tmp_path, "while True: pass") as board, Terminal(board.port) as host:
        time.sleep(1.0)
        host.write(b"\x03")
        host.until(b">>> ")
        host.write(b"print(6 * 7, '%s')\r" % (b"x" * 700))
        host.until(b"42 " + b"x" * 700)
