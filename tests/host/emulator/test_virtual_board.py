"""The virtual board: chips, clock and memory as real MicroPython sees them."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest
from board_programs import STREAM_FIFO, STREAM_POLLED, Terminal, firmware
from board_runs import WHO, printed, run, turning

from hubodo.emulator.board.settings import BoardSettings, Clock, Flash, Host, SensorBoard
from hubodo.emulator.chips.faults import BusNack, StuckBus
from hubodo.emulator.chips.imu import Specimen
from hubodo.emulator.motion import StillMotion
from hubodo.emulator.virtual_node import VirtualNode, fill_flash


@pytest.mark.parametrize("kind", ["micropython", "cpython"])
def test_firmware_reads_who_am_i_of_the_emulated_chip(tmp_path: Path, kind: str) -> None:
    assert printed(run(tmp_path, WHO, board=BoardSettings(interpreter=kind))) == ["105 [30, 107]"]


def test_a_board_gets_firmware_and_settings_and_neither_documents_nor_caches(tmp_path: Path) -> None:
    for name in ("main.py", "README.md", "drivers/chip.mpy", "__pycache__/main.pyc", "__pycache__/main.py"):
        path = tmp_path / "source" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(name)
    fill_flash(Flash(tmp_path / "source", {"node_id": 2}), tmp_path / "flash")
    files = {path.relative_to(tmp_path / "flash").as_posix() for path in (tmp_path / "flash").rglob("*.*")}
    assert files == {"main.py", "drivers/chip.mpy", "config.json"}


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
def test_the_output_has_every_sample_of_the_chip(tmp_path: Path, kind: str) -> None:
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


@pytest.mark.repeat
def test_a_hundred_thousand_samples_run_in_much_less_than_a_minute_of_the_processor(tmp_path: Path) -> None:
    began = time.process_time()
    program = STREAM_FIFO % {"odr": 8, "n": 100_000, "batch": 8, "nap": 2000}
    node = run(tmp_path, program, 64.0, turning())
    got = np.frombuffer(node.output[:1_200_000], "<i2").reshape(-1, 6)
    assert np.array_equal(got, node.chip.truth().raw[:100_000])
    assert time.process_time() - began + node.stats["interpreter_cpu"] < 30
    node.stop()


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
        assert node.wait(300)
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


def test_ticks_wrap_at_2_to_the_30_and_follow_the_device_clock(tmp_path: Path) -> None:
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


def test_a_refused_transfer_and_a_stuck_bus_raise_the_errors_of_the_rp2_port(tmp_path: Path) -> None:
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
