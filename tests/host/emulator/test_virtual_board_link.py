"""The virtual board's USB port as seen by a host: terminal, prompt, mpremote, unplugging, line noise."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from board_programs import CHATTER, Terminal, firmware
from hypothesis import given
from hypothesis import strategies as st

from hubodo.emulator.board.link import LineNoise
from hubodo.emulator.board.settings import Flash, Host
from hubodo.emulator.motion import StillMotion
from hubodo.emulator.virtual_node import VirtualNode
from virtual_runs import virtual_node

HOST = Host(wait=True)
ECHO = """
import micropython, select, sys
micropython.kbd_intr(-1)
p = select.poll(); p.register(sys.stdin, select.POLLIN)
one = bytearray(1)
sys.stdout.buffer.write(b'ready')
while True:
    for _ in p.ipoll(0):
        sys.stdin.buffer.readinto(one)
        sys.stdout.buffer.write(one)
        if one[0] == 0x21: raise SystemExit
"""


def node(tmp_path: Path, main: str | None = None, host: Host = HOST, seed: int = 0) -> VirtualNode:
    folder = firmware(tmp_path / "fw", **({"main": main} if main is not None else {}))
    return VirtualNode(StillMotion(), Flash(folder), host=host, seed=seed, own_process=False)


def test_every_byte_passes_unchanged_in_both_directions_once_ctrl_c_is_disabled(tmp_path: Path) -> None:
    with node(tmp_path, ECHO) as board, Terminal(board.port) as host:
        host.until(b"ready")
        payload = bytes(b for b in range(256) if b != 0x21)
        host.write(payload)
        assert host.until(payload[-4:]) == payload


BUSY = """
import hashlib, micropython, sys, time
micropython.kbd_intr(-1)
print('on')
time.sleep_ms(400)
got = sys.stdin.buffer.read(4000)
sys.stdout.buffer.write(hashlib.sha256(got).digest() + b'over')
"""


def test_a_busy_program_loses_no_byte_of_the_host_because_usb_makes_it_wait(
    tmp_path: Path,
) -> None:
    payload = np.random.default_rng(1).bytes(4000)
    with node(tmp_path, BUSY) as board, Terminal(board.port) as host:
        host.until(b"on")
        for at in range(0, 4000, 250):
            host.write(payload[at : at + 250])
            time.sleep(0.005)
        assert hashlib.sha256(payload).digest() in host.until(b"over")


def test_ctrl_d_is_a_soft_reset_that_runs_main_again_and_forgets_names(tmp_path: Path) -> None:
    with node(tmp_path, "print('main', 'x' in globals())") as board, Terminal(board.port) as host:
        host.until(b"main False")
        host.until(b">>> ")
        host.write(b"x = 1\r")
        host.until(b">>> ")
        host.write(b"\x04")
        host.until(b"MPY: soft reboot")
        host.until(b"main False")
        assert board.stats["resets"] == []


def test_raw_prompt_runs_code_and_a_soft_reset_there_leaves_main_out(tmp_path: Path) -> None:
    with node(tmp_path, "print('main runs')") as board, Terminal(board.port) as host:
        host.until(b">>> ")
        host.write(b"\x01")
        host.until(b"raw REPL; CTRL-B to exit\r\n>")
        host.write(b"print(6 * 7)\x04")
        assert host.until(b"\x04>") == b"OK42\n\x04\x04>" or host.data
        host.write(b"\x04")
        after = host.until(b"raw REPL; CTRL-B to exit\r\n>")
        assert b"soft reboot" in after and b"main runs" not in after


def test_unmodified_mpremote_copies_lists_hashes_executes_and_resets(tmp_path: Path) -> None:
    source = tmp_path / "module.py"
    source.write_bytes(b"# \xc3\xa4\n" + b"x = 1\n" * 400)
    command = [sys.executable, "-m", "mpremote", "connect"]

    def mpremote(*arguments: str) -> str:
        done = subprocess.run([*command, board.port, *arguments], capture_output=True, timeout=300, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout

    with VirtualNode(
        StillMotion(), Flash(firmware(tmp_path / "fw", main="import time\nwhile True: time.sleep_ms(5)"))
    ) as board:
        mpremote("fs", "mkdir", ":lib", "+", "fs", "cp", str(source), ":lib/module.py")
        assert "module.py" in mpremote("fs", "ls", ":lib") and str(source.stat().st_size) in mpremote(
            "fs", "ls", ":lib"
        )
        assert hashlib.sha256(source.read_bytes()).hexdigest() in mpremote(
            "fs", "sha256sum", ":lib/module.py"
        )
        assert mpremote("exec", "import module; print(module.x + 1)").strip() == "2"
        assert (board.flash / "lib" / "module.py").read_bytes() == source.read_bytes()
        mpremote("reset")
        end = time.monotonic() + 300
        while not (board.stats["resets"] and Path(board.port).exists()) and time.monotonic() < end:
            time.sleep(0.05)
        assert [why for _, why in board.stats["resets"]] == ["machine.reset"]
        failed = subprocess.run(
            [*command, board.port, "fs", "cat", ":nope"], capture_output=True, text=True, timeout=300
        )
        assert failed.returncode == 1 and "No such file" in failed.stderr


def test_unplugging_closes_the_terminal_and_a_new_one_has_the_same_link(tmp_path: Path) -> None:
    with node(tmp_path, CHATTER) as board:
        with Terminal(board.port) as host:
            host.until(b"000100\n")
            before = Path(board.port).readlink()
            board.unplug()
            assert not os.path.lexists(board.port)
            end = time.monotonic() + 300
            while host.pump(0.01):
                assert time.monotonic() < end
            time.sleep(0.1)
            board.replug()
            assert Path(board.port).readlink() != before
        with Terminal(board.port) as host:
            host.until(b"\n")
            host.until(b"000500\n")
        assert board.stats["link"]["discarded"] > 0
        assert board.stats["resets"] == []


def test_without_a_reader_bytes_are_discarded_and_the_program_continues(tmp_path: Path) -> None:
    with VirtualNode(
        StillMotion(), Flash(firmware(tmp_path / "fw", main=CHATTER)), own_process=False
    ) as board:
        end = time.monotonic() + 300
        while board.stats["counts"].get("bytes_out", 0) < 2000:
            assert time.monotonic() < end
            time.sleep(0.05)
        stats = board.stats
        assert stats["link"]["discarded"] == stats["counts"]["bytes_out"]
        assert stats["counts"].get("bytes_dropped", 0) == 0


FLOOD = """
import sys, time, select
p = select.poll(); p.register(sys.stdout, select.POLLOUT)
chunk = bytearray(200)
while p.poll(0):
    sys.stdout.buffer.write(chunk)
t = time.ticks_ms()
sys.stdout.buffer.write(chunk)
sys.stdout.buffer.write(chunk)
spent = time.ticks_diff(time.ticks_ms(), t)
with open('/spent', 'w') as f: f.write(str(spent))
"""


def test_a_host_that_holds_the_port_and_does_not_read_costs_each_write_half_a_second_and_then_bytes(
    tmp_path: Path,
) -> None:
    with virtual_node(
        5.0, StillMotion(), Flash(firmware(tmp_path / "fw", main=FLOOD)), host_pauses=[(0.0, 5.0)]
    ) as board:
        assert board.wait(60)
        assert int((board.flash / "spent").read_text()) == pytest.approx(2 * 500, abs=20)
        assert board.stats["counts"]["bytes_dropped"] > 0


@given(
    corrupt=st.floats(0, 1),
    lose=st.floats(0, 1),
    seed=st.integers(0, 2**32 - 1),
    data=st.binary(max_size=300),
)
def test_line_noise_is_counted_and_repeatable(corrupt: float, lose: float, seed: int, data: bytes) -> None:
    noise, again = LineNoise(corrupt, lose, seed), LineNoise(corrupt, lose, seed)
    out = noise.apply(data)
    assert out == again.apply(data)
    assert len(out) == len(data) - noise.counts["lost"]
    if not lose:
        assert sum(a != b for a, b in zip(data, out, strict=True)) == noise.counts["corrupted"]


def test_line_noise_keeps_its_promised_rate() -> None:
    noise = LineNoise(corrupt=0.01, seed=3)
    noise.apply(bytes(200_000))
    assert noise.counts["corrupted"] == pytest.approx(2000, abs=5 * np.sqrt(2000))


def test_link_writes_have_bytes_written_and_received(tmp_path: Path) -> None:
    with (
        node(tmp_path, CHATTER, Host(wait=True, corrupt=0.05, log=True), seed=5) as board,
        Terminal(board.port) as host,
    ):
        end = time.monotonic() + 300
        while len(host.data) < 3000 and time.monotonic() < end:
            host.pump()
        log = board.link_writes()
        sent = b"".join(after for _, _, after, listening in log if listening)
        assert sent.startswith(host.data[:2900]) and b"".join(clean for _, clean, _, _ in log).startswith(
            b"000000\n"
        )
        assert sent != b"".join(clean for _, clean, _, _ in log)
