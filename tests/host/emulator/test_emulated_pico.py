"""The emulated Pico: processor, chips, pins, flash and faults as its own MicroPython sees them."""

from __future__ import annotations

import struct
import subprocess
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from board_programs import firmware

import wanted
from hubodo.emulator.board.settings import BoardSettings, Clock, Flash, Host, SensorBoard
from hubodo.emulator.chips.faults import BrownOut, BusNack, Reset, ScriptedFault, Stall, StuckBus
from hubodo.emulator.interpreters.find import find_node
from hubodo.emulator.interpreters.rp2040 import image as images
from hubodo.emulator.interpreters.rp2040.filesystem import (
    FlashUnreadable,
    make_flash,
    mirror_flash,
    read_flash,
)
from hubodo.emulator.interpreters.rp2040.image import ImageMissing, find_image
from hubodo.emulator.interpreters.rp2040.pico import PicoSettings
from hubodo.emulator.motion import RecordedMotion, StillMotion
from hubodo.emulator.virtual_node import VirtualNode
from repetitions import first_and_more
from virtual_runs import pico_or_skip

RUNNERS = Path(images.__file__).parent
# What is printed before the host has enumerated the device is lost, as with a real one.
QUICK = PicoSettings(miss_cycles=0)
PICO, CLOCK, SENSORS = BoardSettings(pico=QUICK), Clock(), SensorBoard()
READY = "import time\ntime.sleep_ms(400)\n"
I2C = READY + "import machine\ni2c = machine.I2C(0, scl=machine.Pin(5), sda=machine.Pin(4), freq=400000)\n"


@pytest.fixture(autouse=True)
def _needs_an_image():
    pico_or_skip()


def run(
    tmp_path: Path,
    main: str,
    seconds: float = 1.0,
    motion: Any = None,
    *,
    folder: Path | None = None,
    board: BoardSettings = PICO,
    clock: Clock = CLOCK,
    faults: Sequence[ScriptedFault] = (),
    sensors: SensorBoard = SENSORS,
) -> VirtualNode:
    """A started node whose emulated time has run out."""
    node = VirtualNode(
        motion or StillMotion(),
        Flash(firmware(tmp_path / "fw", main=main), folder=folder),
        board=replace(board, interpreter="rp2040"),
        clock=replace(clock, kind="stepped", run_for=seconds),
        host=Host("memory"),
        faults=faults,
        sensors=sensors,
        own_process=False,
    )
    node.start()
    assert node.wait(60)
    return node


def printed(node: VirtualNode) -> list[str]:
    lines = node.output.decode().split("\r\nMicroPython v")[0].replace("\r", "")
    node.stop()
    return [line for line in lines.splitlines() if line and not line.startswith("MPY:")]


def test_it_is_a_pico_with_the_number_and_the_battery_of_its_settings(tmp_path: Path) -> None:
    program = (
        READY
        + """
import machine, sys, binascii, gc
print(sys.platform, sys.implementation._machine, sys.implementation._mpy >> 10, machine.freq())
print(binascii.hexlify(machine.unique_id()).decode(), machine.reset_cause(), gc.mem_free() > 150000)
print(round(machine.ADC(machine.Pin(29)).read_u16() * 9900 / 65535 / 20) * 20)
"""
    )
    node = run(
        tmp_path, program, board=BoardSettings(pico=QUICK, unique_id="0123456789abcdef", battery_mv=4020.0)
    )
    assert printed(node) == [
        "rp2 Raspberry Pi Pico with RP2040 4 125000000",
        "0123456789abcdef 1 True",
        "4020",
    ]


def test_samples_of_the_chip_are_transferred_over_the_bus(tmp_path: Path) -> None:
    """A burst of 32 samples is 384 bytes of nine bits at 377.6 kHz, 9.15 ms."""
    program = I2C + (
        "for r, v in ((0x12, 0x44), (0x08, 0x09), (0x0A, 0x36), (0x10, 0x64), (0x11, 0x6C)):\n"
        "    i2c.writeto_mem(0x6B, r, bytes((v,)))\n"
        "time.sleep_ms(120)\n"
        "t = time.ticks_us()\n"
        "got = i2c.readfrom_mem(0x6B, 0x3E, 384)\n"
        "took = time.ticks_diff(time.ticks_us(), t)\n"
        "import sys\nsys.stdout.buffer.write(got)\nprint('|', took)\n"
    )
    t = np.arange(0, 5, 0.01)
    motion = RecordedMotion(t, np.stack([t, 2 * t, 3 * t], 1), np.stack([t, -t, 9 + t], 1))
    node = run(tmp_path, program, 1.0, motion)
    raw, took = node.output[:384], int(node.output[384:].split(b"|")[1].split()[0])
    expected = node.chip.truth().raw[:32]
    node.stop()
    np.testing.assert_array_equal(np.frombuffer(raw, "<i2").reshape(-1, 6), expected)
    assert 9150 < took < 9900


def test_a_refused_transfer_and_a_stuck_bus_are_reported_and_nine_clocks_free_it(tmp_path: Path) -> None:
    program = (
        I2C
        + """
def who():
    global i2c
    try: return i2c.readfrom_mem(0x6B, 0x0F, 1)[0]
    except OSError as e: return -e.errno
time.sleep_ms(500)
print(who(), who(), who())
time.sleep_ms(500)
t = time.ticks_ms()
try: i2c.writeto(0x6B, b'\\x0f')
except OSError as e: print(e.errno, time.ticks_diff(time.ticks_ms(), t) // 10)
sda = machine.Pin(4, machine.Pin.OPEN_DRAIN, value=1); scl = machine.Pin(5, machine.Pin.OPEN_DRAIN, value=1)
pulses = 0
while not sda.value() and pulses < 20:
    scl.value(0); scl.value(1); pulses += 1
sda.value(0)
low = sda.value()
sda.value(1)
i2c = machine.I2C(0, scl=machine.Pin(5), sda=machine.Pin(4), freq=400000)
print(pulses, low, sda.value(), who())
"""
    )
    node = run(tmp_path, program, 2.4, faults=[BusNack(0.6, 2), StuckBus(1.4)])
    assert printed(node) == ["-5 -5 105", "110 5", "9 0 1 105"]


def test_an_unfed_watchdog_restarts_the_board_with_its_cause(tmp_path: Path) -> None:
    program = READY + "import machine\nprint(machine.reset_cause())\ndog = machine.WDT(timeout=300)\n"
    program += "time.sleep_ms(200)\ndog.feed()\n" * 2
    node = run(tmp_path, program + "while True: time.sleep_ms(20)", 2.2)
    (first, why), *_ = node.stats["resets"]
    assert why == "watchdog" and 1.1 < first < 1.5
    assert printed(node)[:2] == ["1", "3"]


def test_a_brown_out_resets_the_chips_and_the_reset_pin_does_not(tmp_path: Path) -> None:
    program = I2C + "print(i2c.readfrom_mem(0x6B, 0x10, 1)[0])\ni2c.writeto_mem(0x6B, 0x10, b'\\x64')\n"
    program += "while True: time.sleep_ms(20)\n"
    node = run(tmp_path, program, 2.7, faults=[Reset(0.9), BrownOut(1.8)])
    assert [why for _, why in node.stats["resets"]] == ["reset pin", "brown-out"]
    assert printed(node)[:3] == ["0", "100", "0"]


def test_a_stalled_processor_loses_time(tmp_path: Path) -> None:
    program = READY + "worst = 0\nlast = time.ticks_us()\nfor _ in range(3000):\n"
    program += (
        "    now = time.ticks_us()\n    worst = max(worst, time.ticks_diff(now, last))\n    last = now\n"
    )
    program += "    time.sleep_us(100)\nprint(worst // 1000)\n"
    assert printed(run(tmp_path, program, 1.9, faults=[Stall(0.8, 0.08)])) == ["80"]


def test_clock_drift_and_first_tick_follow_the_settings(tmp_path: Path) -> None:
    program = (
        READY + "import machine\nprint(time.ticks_us() // 1000000)\ntime.sleep_ms(1000)\nmachine.reset()\n"
    )
    fast = run(tmp_path, program, 2.2, clock=Clock(ppm=50_000.0, ticks_start_us=7_000_000))
    slow = run(tmp_path / "slow", program, 2.2, clock=Clock(ticks_start_us=7_000_000))
    gained = slow.stats["resets"][0][0] / fast.stats["resets"][0][0]
    assert gained == pytest.approx(1.05, abs=0.001)
    assert printed(fast)[0] == printed(slow)[0] == "7"


def test_files_outlive_a_reset_and_are_on_the_host(tmp_path: Path) -> None:
    program = (
        READY
        + """
import os, machine
if 'n.txt' in os.listdir():
    print(open('/n.txt').read(), sorted(os.listdir('/')), os.listdir('/d'))
else:
    os.mkdir('/d')
    with open('/d/old', 'w') as f: f.write('x')
    os.rename('/d/old', '/d/new')
    with open('n.txt', 'w') as f: f.write('kept')
    machine.reset()
"""
    )
    node = run(tmp_path, program, 3.0, folder=tmp_path / "flash")
    assert [why for _, why in node.stats["resets"]] == ["machine.reset"]
    assert printed(node) == ["kept ['d', 'main.py', 'n.txt'] ['new']"]
    assert (tmp_path / "flash" / "n.txt").read_text() == "kept"
    assert (tmp_path / "flash" / "d" / "new").read_text() == "x"


@pytest.mark.parametrize("seconds", first_and_more(1.17, 1.02, 1.3))
def test_power_lost_in_the_middle_of_a_write_leaves_the_old_file_or_the_new_one(
    tmp_path: Path, seconds: float
) -> None:
    """Erasing a sector takes 45 ms: power is cut at times before, during and after it."""
    program = "n = 0\nwhile True:\n    n += 1\n    with open('f', 'w') as f: f.write('%06d' % n * 700)\n"
    chip = tmp_path / "flash.bin"
    run(
        tmp_path, program, seconds, board=BoardSettings(pico=PicoSettings(miss_cycles=0, flash_image=chip))
    ).stop()
    stored = read_flash(chip).get("f", b"")
    assert len(stored) in (0, 4200)
    assert len({stored[k : k + 6] for k in range(0, len(stored), 6)}) <= 1
    again = run(tmp_path, "", 0.8, board=BoardSettings(pico=PicoSettings(miss_cycles=0, flash_image=chip)))
    assert "f" in {p.name for p in again.flash.iterdir()} or not stored
    again.stop()


def test_a_flash_image_contains_its_files(tmp_path: Path) -> None:
    folder, chip, out = tmp_path / "files", tmp_path / "chip", tmp_path / "out"
    (folder / "a").mkdir(parents=True)
    (folder / "a" / "b.py").write_bytes(bytes(range(256)) * 40)
    (folder / "empty").write_bytes(b"")
    make_flash(chip, b"firmware", folder)
    out.mkdir()
    (out / "stale").write_text("goes")
    mirror_flash(chip, out)
    assert sorted(p.relative_to(out).as_posix() for p in out.rglob("*")) == ["a", "a/b.py", "empty"]
    assert (out / "a" / "b.py").read_bytes() == bytes(range(256)) * 40
    chip.write_bytes(chip.read_bytes()[:0xA0000] + bytes(range(256)) * 5632)
    with pytest.raises(FlashUnreadable, match="no valid file system"):
        mirror_flash(chip, out)


def test_the_form_that_micropython_org_gives_is_the_same_image(tmp_path: Path) -> None:
    """Blocks of 256 bytes in UF2, as described in its specification."""
    plain, blocks = find_image().contents(), []
    for at in range(0, len(plain), 256):
        data = plain[at : at + 256].ljust(256, b"\0")
        head = struct.pack(
            "<8I", 0x0A324655, 0x9E5D5157, 0x2000, 0x10000000 + at, 256, at // 256, 0, 0xE48BFF56
        )
        blocks.append(head + data.ljust(476, b"\0") + struct.pack("<I", 0x0AB16F30))
    packed = tmp_path / "RPI_PICO.uf2"
    packed.write_bytes(b"".join(blocks))
    stored = find_image(packed, find_image().bootrom)
    assert stored.contents()[: len(plain)] == plain and stored.symbols is None
    packed.write_bytes(blocks[0].replace(struct.pack("<I", 0xE48BFF56), struct.pack("<I", 0xE48BFF59)))
    with pytest.raises(ImageMissing, match="block 0 is not for the flash of an RP2040"):
        stored.contents()


def test_the_source_of_a_missing_image_or_bootrom_is_named_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(ImageMissing, match=r"micropython\.org/download/RPI_PICO") as missing:
        find_image(tmp_path)
    assert "\n" not in str(missing.value)
    (tmp_path / "RPI_PICO.uf2").write_bytes(b"UF2\n")
    with pytest.raises(ImageMissing, match="pico-bootrom-rp2040/releases"):
        VirtualNode(
            StillMotion(), board=BoardSettings(interpreter="rp2040", pico=PicoSettings(image=tmp_path))
        )


ROUNDS = """
import gc
def add(p):
    for _ in range(p[0]): c = p[1] + p[2]
def div(p):
    for _ in range(p[0]): c = p[1] / p[2]
for f, a, b in ((add, 12345678, 56781234), (div, 99999991, 45481), (div, 99999991.2345, 45481.1357)):
    gc.collect()
    t = time.ticks_us()
    f([10000, a, b])
    print(time.ticks_diff(time.ticks_us(), t))
"""


def test_arithmetic_takes_the_time_measured_on_a_real_pico(tmp_path: Path) -> None:
    """Published times for an RP2040 at 125 MHz whose interpreter is in RAM: 80, 126 and 134 ms."""
    usual = find_image().firmware
    image = usual.with_name(f"{usual.stem}-vm-in-sram{usual.suffix}")
    if not image.is_file():
        wanted.lacking(f"{image} is not there")
    node = run(
        tmp_path, READY + ROUNDS, 1.2, board=BoardSettings(pico=PicoSettings(image=image, miss_cycles=50))
    )
    assert [int(us) / 1000 for us in printed(node)] == pytest.approx([80, 126, 134], rel=0.03)


BUSY = """
import struct
x, n, d = 0.5, 1, {}
while True:
    x = x * 1.7 % 3.1 - 1 / (n + 0.3)
    n = n * 7919 % 1000003
    d[n % 13] = struct.pack('<hIf', -n % 999, n, x)
    s = sorted(d.values(), key=lambda b: b[3])
    n ^= len(str(x)) << 2 | int.from_bytes(s[0], 'big') % 97
"""


def test_the_fast_core_agrees_with_the_core_of_the_emulator(tmp_path: Path) -> None:
    """Registers and flags are compared instruction by instruction from power-on into a program."""
    make_flash(tmp_path / "chip", find_image().contents(), firmware(tmp_path / "fw", main=BUSY))
    script = Path(__file__).with_name("lockstep.mjs")
    words = [
        find_node(),
        str(script),
        str(RUNNERS),
        str(tmp_path / "chip"),
        str(find_image().bootrom),
        "1500000",
    ]
    done = subprocess.run(words, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.strip() == "1500000 instructions alike"


def test_a_chip_on_spi_is_read_in_bytes_and_in_bursts_that_take_the_time_of_their_bits(
    tmp_path: Path,
) -> None:
    """At 1 MHz the 65 bytes of a burst take 520 us. The FIFO is empty at first: bytes of 0xff."""
    program = (
        READY
        + """
import machine
spi = machine.SPI(0, baudrate=1000000, sck=machine.Pin(18), mosi=machine.Pin(19), miso=machine.Pin(16))
select = machine.Pin(13, machine.Pin.OUT, value=1)
def read(register, n):
    data = bytearray(n)
    select.value(0)
    spi.write(bytes([register | 0x80]))
    spi.readinto(data)
    select.value(1)
    return data
print(hex(read(0x75, 1)[0]), bytes(read(0x4E, 3)) == b"".join(read(0x4E + k, 1) for k in range(3)))
begin = time.ticks_us()
fifo = read(0x30, 64)
took = time.ticks_diff(time.ticks_us(), begin)
print(set(fifo), 520 <= took < 900)
select.value(0)
spi.write(bytes([0x4F, 0x06]))
select.value(1)
print(hex(read(0x4F, 1)[0]))
"""
    )
    node = run(tmp_path, program, sensors=SensorBoard("icm42688", select_pin=13))
    assert printed(node) == ["0x47 True", "{255} True", "0x6"]
