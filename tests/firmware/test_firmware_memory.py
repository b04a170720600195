"""The node allocates nothing while sampling, and fits its heap, in real MicroPython."""

from collections import Counter

import pytest
import real_micropython

import hubowire
from hubowire import messages

SAMPLES, SECONDS = 70_000, 12.0
"""More than a counter of 16 bits holds, by the longest way; fewer by the others, which count as it does."""
INIT_SAMPLES, SPINNING_INIT_SAMPLES = 2_000, 8_192
"""The initialisation takes this many, and more on a turning wheel."""
DRIVER_SAMPLES = 3_000
"""By one driver more, whose counters are those of the others."""
LONGEST_CASE = "lsm6ds33-416"
SAME_MODULES = ("lsm6ds33-208-polled", "lsm6ds33-1660")
"""Cases whose modules all occur in other cases."""

HEAP = 96 * 1024
ROOM = 8 * 1024
"""Heap that every choice of settings leaves free of the above, garbage excluded."""

MODULES = [
    *("wire", "buffers", "framing", "outbox", "sample_clock", "poll_timing", "sampler"),
    "bias_initialiser",
    *("drivers.chip", "drivers.lis3mdl", "parts", "bias_choice"),
    *("board", "link", "reports", "commands", "node"),
]
FIFO, POLLED = ("fifo_samples",), ("polled_samples",)
KALMAN = ("bias_filter",)
RLS = ("small_float", "rls_filter")
PSEUDO = ("small_float", "pseudo_filter", "pseudo_init")
MEANS = ("mean_sums",)
STATIC = ("static_init",)
HIGH_G = ("wire_more", "drivers.adxl375", "high_g")

BUS = """
import gc, json, micropython, sys, time
sys.path.insert(0, "/")
import machine
from fake_bus import FakeBus
bus = FakeBus("{imu}", {period}, {spin})
bus.has_high_g = {high_g}

class FakeBoard:
    kind = boot_id = reset_cause = 0
    serial = bytes(8)
    def __init__(self, bus, values):
        self.i2c = bus
        self.settings = values
    def battery_mv(self):
        return 3700
    def feed(self):
        pass
"""

START = """
high = live = 0
base = gc.mem_alloc()
def watch():
    global high
    high = max(high, gc.mem_alloc() - base)
    gc.collect()
def measure():
    global live
    live = max(live, gc.mem_alloc() - base)
"""

BOARD = """
import settings
from link import UsbLink
from node import Node

values = dict(settings.DEFAULTS)
values["rate_hz"] = {rate}
values.update({settings})
del sys.modules["settings"], settings
UsbLink.wait = lambda self, ms: time.sleep_ms(ms)
if "high_g_rate_hz" in values:
    from high_g import HighGNode as Node
link = UsbLink()
board = FakeBoard(bus, values)
watch()
"""

# This MicroPython port collects garbage only between pieces of code, a board whenever necessary.
NODE = (
    "node = Node(board, link)\nwatch()",
    "chip = node.parts.chip",
    "node.new_init()\nnode.init.start({samples}, chip.gyro_lsb_ndps, chip.accel_lsb_ng)\nwatch()",
    # Measured after a piece that collects garbage and another piece: the remaining memory is in use.
    *("watch()", "measure()"),
    "for _ in range(20):\n    node.step()\nwatch()",
)

RUN_LOCKED = """
def locked(samples):
    failure = None
    before = gc.mem_alloc()
    turns = 0
    micropython.heap_lock()
    try:
        while node.sampler.clock.index < samples:
            time.run_until(node.sampler.due_us)
            node.step()
            turns += 1
    except BaseException as error:
        failure = error
    finally:
        micropython.heap_unlock()
    if failure is not None:
        sys.print_exception(failure)
    return [repr(failure) if failure else None, gc.mem_alloc() - before, turns]
failure, allocated, turns = locked({samples})
watch()
node.farewell()
with open("/result", "w") as file:
    json.dump({{"failure": failure, "allocated": allocated, "turns": turns, "high": high,
        "live": live, "missed": node.sampler.missed, "dropped": node.outbox.dropped,
        "kinds": [type(node.init).__name__, type(node.estimator).__name__]}}, file)
"""

WARM = {
    "bias_udps": [100000, -50000, 0],
    "warmup_udps": [300000, 0, -200000],
    "warmup_s": 60,
    "warmup_second": [-100000, 0, 50000, 500],
}
CASES = {
    # name: (driver, rate, true period in us, whether the wheel turns, settings, additional modules)
    "lsm6ds33-416": ("lsm6ds33", 416, 2370, 0, {}, (*FIFO, *STATIC, *KALMAN)),
    "lsm6ds33-208-polled": ("lsm6ds33", 208, 4700, 0, {"fifo": False}, (*POLLED, *STATIC, *KALMAN)),
    "lsm6ds33-1660": ("lsm6ds33", 1660, 610, 0, {}, (*FIFO, *STATIC, *KALMAN)),
    "lsm6dso-416": ("lsm6dso", 416, 2370, 0, {}, (*FIFO, *STATIC, *KALMAN)),
    "lsm6dsv-480": ("lsm6dsv", 480, 2050, 0, {}, (*FIFO, *STATIC, *KALMAN)),
    "mpu6050-200-warm-rest": (
        "mpu6050",
        200,
        5050,
        0,
        {"fifo": False, "bias_kind": 1, **WARM},
        (*POLLED, *KALMAN, *STATIC, *PSEUDO, *MEANS, "warm_up"),
    ),
    "lsm6ds33-416-high-g": (
        *("lsm6ds33", 416, 2370, 0),
        {"high_g_rate_hz": 400},
        (*FIFO, *STATIC, *KALMAN, *HIGH_G),
    ),
    "lsm6ds33-833-table-rls-high-g": (
        *("lsm6ds33", 833, 1200, 0),
        {"bias_kind": 2, "table_rate_udps": 1400000, "filter_kind": 2, "high_g_rate_hz": 400},
        (*FIFO, *PSEUDO, *MEANS, *RLS, *HIGH_G),
    ),
    "mpu6050-1000-table-rls": (
        *("mpu6050", 1000, 1003, 0),
        {"bias_kind": 2, "table_rate_udps": 1400000, "filter_kind": 2},
        (*FIFO, *PSEUDO, *MEANS, *RLS),
    ),
    "lsm6ds33-208-warm-gravity-rls": (
        *("lsm6ds33", 208, 4700, 1),
        {
            "bias_kind": 3,
            "bias_stretch": 1024,
            "filter_kind": 2,
            "arm_mm": [20, -5],
            "wheel_radius_mm": 310,
            **WARM,
        },
        (*FIFO, *PSEUDO, *RLS, "gravity_init", "warm_up"),
    ),
}

INITS = {0: "StaticInit", 1: "PseudoInit", 2: "PseudoInit", 3: "GravityInit"}
ESTIMATORS = {1: "KalmanFilter", 2: "RlsFilter"}


def samples_of(case):
    if case == LONGEST_CASE:
        return SAMPLES
    if case.endswith(("-416", "-480")):
        return DRIVER_SAMPLES
    _, rate, _, spin, *_ = CASES[case]
    return max(round(SECONDS * rate), (SPINNING_INIT_SAMPLES if spin else INIT_SAMPLES) + 500)


def run(folder, case):
    """Run a case; return its result and the stream sent."""
    imu, rate, period, spin, settings, modules = CASES[case]
    imports = [f"import {name}\nwatch()" for name in dict.fromkeys((f"drivers.{imu}", *MODULES, *modules))]
    bus = BUS.format(imu=imu, period=period, spin=spin, high_g="high_g_rate_hz" in settings)
    board = BOARD.format(rate=rate, settings=repr(settings))
    node = [piece.format(samples=SPINNING_INIT_SAMPLES if spin else INIT_SAMPLES) for piece in NODE]
    locked = RUN_LOCKED.format(samples=samples_of(case))
    return real_micropython.run(folder, bus, START, *imports, board, *node, locked)


@pytest.mark.parametrize(
    "case",
    [pytest.param(case, marks=pytest.mark.repeat) if case in SAME_MODULES else case for case in CASES],
)
def test_samples_pass_from_chip_to_link_without_an_allocation(tmp_path, case):
    _, _, _, spin, settings, _ = CASES[case]
    result, stream = run(tmp_path, case)
    assert result["failure"] is None, stream[-3000:]
    assert result["allocated"] == 0
    assert result["dropped"] == result["missed"] == 0
    kinds = [INITS[settings.get("bias_kind", 0)], ESTIMATORS[settings.get("filter_kind", 1)]]
    assert result["kinds"] == kinds, "the configured initialisation and filter have run"
    print(
        f"{case}: heap {result['live']} bytes in use, {result['high']} with garbage; {result['turns']} turns"
    )
    assert result["high"] <= HEAP
    assert result["live"] <= HEAP - ROOM

    decoder = hubowire.FrameDecoder()
    sent = [(f.type_id, hubowire.decode(f.type_id, f.payload)) for f in decoder.feed(stream)]
    assert decoder.damage.frames == 0
    batches = [message for _, message in sent if isinstance(message, messages.ImuBatch)]
    rows = [row for batch in batches for row in batch.samples]
    assert len(rows) >= samples_of(case) - 16
    if not spin:
        # Samples taken during the set-up are not sent.
        first = rows[0][0]
        assert first <= 1
        assert rows == [
            (k % 32, -(k % 32), k % 7, -(k % 5), 700, 1900) for k in range(first, first + len(rows))
        ]
    assert {batch.temperature_raw for batch in batches[20:]} == {0x1234}
    kinds = Counter(type(message).__name__ for _, message in sent)
    least = 3 if samples_of(case) != DRIVER_SAMPLES else 0
    assert min(kinds[name] for name in ("Hello", "Health", "Filter", "Mag")) > least
    *_, last = (m for _, m in sent if isinstance(m, messages.Filter))
    assert last.state == messages.FilterState.TRACKING and last.samples == (
        SPINNING_INIT_SAMPLES if spin else INIT_SAMPLES
    )


BMI088_BUS = """
import gc, json, micropython, sys
sys.path.insert(0, "/")
from array import array
from drivers.bmi088 import BMI088

class Bus:
    def __init__(self):
        self.registers = {0x1800: 0x1E, 0x6800: 0x0F, 0x680E: 17, 0x1824: 35 * 7}
    def writeto_mem(self, address, register, buffer):
        pass
    def readfrom_mem_into(self, address, register, buffer):
        if address << 8 | register == 0x1826:
            for at in range(0, len(buffer), 7):
                buffer[at] = 0x84
        else:
            buffer[0] = self.registers.get(address << 8 | register, 0)

chip = BMI088(Bus(), odr_hz=400)
chip.shape(16)
rows, words = bytearray(192), array("h", bytes(12))
"""
BMI088_LOCKED = """
def locked():
    before, torn = gc.mem_alloc(), 0
    micropython.heap_lock()
    try:
        for _ in range(100):
            level = chip.fifo_level()
            torn += chip.fifo_read_into(rows)
            chip.read_temperature()
            chip.fifo_flush()
    finally:
        micropython.heap_unlock()
    return level, torn, gc.mem_alloc() - before
with open("/result", "w") as file:
    json.dump(locked(), file)
"""


def test_the_two_chips_of_a_bmi088_are_read_without_an_allocation(tmp_path):
    result, stream = real_micropython.run(tmp_path, BMI088_BUS, BMI088_LOCKED)
    assert result == [17, 0, 0], stream[-3000:]


SPI_LOCKED = """
import gc, json, micropython, sys, types
sys.path.insert(0, "/")
from drivers.spi_bus import SpiBus

class Spi:
    def value(self, level):
        pass
    def write(self, out):
        pass
    def readinto(self, into, write=0):
        into[0] = 7

spi, buffer = Spi(), bytearray(12)
bus = SpiBus(spi, spi, 1)
def locked():
    before = gc.mem_alloc()
    micropython.heap_lock()
    try:
        for _ in range(100):
            bus.writeto_mem(0, 0x5E, buffer)
            bus.readfrom_mem_into(0, 0x0C, buffer)
    finally:
        micropython.heap_unlock()
    return buffer[0], gc.mem_alloc() - before
with open("/result", "w") as file:
    json.dump(locked(), file)
"""


def test_a_chip_on_spi_is_read_and_written_without_an_allocation(tmp_path):
    result, stream = real_micropython.run(tmp_path, SPI_LOCKED)
    assert result == [7, 0], stream[-3000:]
