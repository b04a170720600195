"""Ctrl-C on the virtual board ends the running program, whenever it is received, and nothing later."""

from __future__ import annotations

import select
from collections import Counter
from pathlib import Path

import pytest
from board_programs import Terminal, firmware

from hubodo.emulator.board.clock import BoardClock
from hubodo.emulator.board.hypercall import FLAG_INTERRUPT
from hubodo.emulator.board.link import LineNoise, MemoryLink
from hubodo.emulator.board.models import MODELS
from hubodo.emulator.board.settings import BoardSettings, Clock, Flash, Host
from hubodo.emulator.board.streams import CTRL_C, BoardStreams
from hubodo.emulator.motion import StillMotion
from hubodo.emulator.virtual_node import VirtualNode
from virtual_runs import virtual_node


def node(tmp_path: Path, main: str | None = None) -> VirtualNode:
    folder = firmware(tmp_path / "fw", **({"main": main} if main is not None else {}))
    return VirtualNode(StillMotion(), Flash(folder), host=Host(wait=True), own_process=False)


def test_ctrl_c_breaks_a_program_that_sleeps_and_one_that_waits_for_input(tmp_path: Path) -> None:
    with node(tmp_path) as board, Terminal(board.port) as host:
        host.until(b">>> ")
        for line in (
            b"import time; print(6 * 7); time.sleep(60)\r",
            b"import sys; print(6 * 7); sys.stdin.read(1)\r",
        ):
            host.write(line)
            host.until(b"\n42")
            host.write(b"\x03")
            host.until(b"KeyboardInterrupt")
            host.until(b">>> ")


WAITS = {
    "sleep": "time.sleep(60)",
    "input": "sys.stdin.read(1)",
    "poll": "p = select.poll(); p.register(sys.stdin, select.POLLIN); p.poll()",
}


@pytest.mark.parametrize("waits", WAITS)
def test_ctrl_c_that_is_met_in_the_output_of_a_line_ends_the_wait_behind_it(
    tmp_path: Path, waits: str
) -> None:
    """The board receives only these outputs; the reply to one of them reports the ctrl-C."""
    lines = ["import time, sys, select", *["time.sleep_us(9000)", "sys.stdout.write('.')"] * 40, WAITS[waits]]
    flash = Flash(firmware(tmp_path / "fw", main="\n".join(lines)))
    with virtual_node(3.0, StillMotion(), flash, script=[(0.2, b"\x03")]) as board:
        assert board.wait(60)
        output = board.output
    assert 0 < output.count(b".", 0, output.index(b"KeyboardInterrupt")) < 40
    assert b">>> " in output


def test_ctrl_c_ends_a_loop_without_calls_within_seconds_at_the_prompt(
    tmp_path: Path,
) -> None:
    with node(tmp_path, "print('on')\nwhile True: pass") as board, Terminal(board.port) as host:
        host.until(b"on")
        host.write(b"\x03")
        host.until(b"KeyboardInterrupt")
        host.until(b">>> ")


def streams(script: list[tuple[float, bytes]]) -> BoardStreams:
    """Return the streams of a board that was never switched on; `read_input` reads the script."""
    settings, poll = BoardSettings(), select.poll()
    clock = BoardClock(Clock("stepped"))
    link = MemoryLink(script)
    return BoardStreams(
        settings, MODELS["pico"], link, LineNoise(), clock, poll, Counter(), lambda handle: False
    )


def test_a_delayed_ctrl_c_is_handled_by_the_program_running_then() -> None:
    """A program changes its interrupt character without a call; the board learns it with the next call."""
    board_streams = streams([(0.0, b"a\x03b")])
    board_streams.set_interrupt_char(CTRL_C)
    board_streams.read_input()
    board_streams.set_interrupt_char(-1)
    assert not board_streams.flags() & FLAG_INTERRUPT
    read = board_streams._read(0, b"\x10\0\0\0\0\0\0\0", 0.0).poll_reply(False)
    assert read is not None and read.payload == b"\x03b"

    board_streams = streams([(0.0, b"a\x03b")])
    board_streams.set_interrupt_char(-1)
    board_streams.read_input()
    board_streams.set_interrupt_char(CTRL_C)
    assert board_streams.flags() & FLAG_INTERRUPT
    assert not board_streams.flags() & FLAG_INTERRUPT, "once"
