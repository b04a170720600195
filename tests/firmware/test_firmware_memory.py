"""In real MicroPython: the node allocates nothing while it samples, and fits its heap."""

import os
from collections import Counter
from concurrent.futures import ThreadPoolExecutor

import pytest
import real_micropython

import hubowire
from hubowire import messages

SAMPLES = 100_000
HEAP = 96 * 1024

MODULES = [
    *("wire", "buffers", "machine", "framing", "outbox", "sample_clock", "sampler", "bias_filter"),
    *(
        "drivers.lsm6ds33",
        "drivers.mpu6050",
        "drivers.lis3mdl",
        "settings",
        "board",
        "link",
        "commands",
        "node",
    ),
]

START = """
import gc, json, micropython, sys, time
sys.path.insert(0, "/")
high = 0
base = gc.mem_alloc()
def look():
    global high
    high = max(high, gc.mem_alloc() - base)
    gc.collect()
"""

NODE = """
import settings
from fake_bus import FakeBus
from link import UsbLink
from node import Node

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

values = dict(settings.DEFAULTS)
values["rate_hz"] = {rate}
values["filter_kind"] = {kind}
bus = FakeBus("{imu}", {period})
link = UsbLink()
node = Node(FakeBoard(bus, values), link)
node.static.begin(2000, node.chip.gyro_lsb_ndps, node.chip.accel_lsb_ng)
for _ in range(20):
    node.turn()
look()
"""

LOCKED = """
def locked(samples):
    failure = None
    before = gc.mem_alloc()
    turns = 0
    micropython.heap_lock()
    try:
        while node.sampler.clock.index < samples:
            time.run_until(node.sampler.due_us)
            node.turn()
            turns += 1
    except BaseException as error:
        failure = error
    finally:
        micropython.heap_unlock()
    if failure is not None:
        sys.print_exception(failure)
    return [repr(failure) if failure else None, gc.mem_alloc() - before, turns]
failure, allocated, turns = locked({samples})
look()
node.farewell()
with open("/result", "w") as file:
    json.dump({{"failure": failure, "allocated": allocated, "turns": turns, "high": high,
        "missed": node.sampler.missed, "dropped": node.outbox.dropped}}, file)
"""

# (driver, rate, true period in us, FilterKind)
CASES = [
    ("lsm6ds33", 208, 4700, 1),
    ("lsm6ds33", 1660, 610, 1),
    ("mpu6050", 200, 5050, 1),
    ("mpu6050", 1000, 1003, 2),
]


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """{case: future of (result, stream)}, as many at a time as there are processors, the longest first."""
    real_micropython.node_or_skip()
    imports = [f"import {name}\nlook()" for name in MODULES]

    def one(case):
        values = dict(zip(("imu", "rate", "period", "kind"), case, strict=True), samples=SAMPLES)
        pieces = (START, *imports, NODE.format(**values), LOCKED.format(**values))
        return real_micropython.run(tmp_path_factory.mktemp("node"), *pieces)

    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        yield {case: pool.submit(one, case) for case in sorted(CASES, key=lambda case: case[1])}


@pytest.mark.parametrize("case", CASES, ids=lambda case: "-".join(map(str, case)))
def test_100000_samples_from_chip_to_link_without_an_allocation(runs, case):
    imu, rate, *_ = case
    result, stream = runs[case].result()
    assert result["failure"] is None, stream[-3000:]
    assert result["allocated"] == 0
    assert result["dropped"] == result["missed"] == 0
    print(f"{imu} {rate} Hz: heap high water {result['high']} bytes in {result['turns']} turns")
    assert result["high"] <= HEAP

    decoder = hubowire.FrameDecoder()
    sent = [(f.type_id, hubowire.decode(f.type_id, f.payload)) for f in decoder.feed(stream)]
    assert decoder.damage.frames == 0
    batches = [message for _, message in sent if isinstance(message, messages.ImuBatch)]
    rows = [row for batch in batches for row in batch.samples]
    assert len(rows) >= SAMPLES - 16
    assert rows == [(k % 32, -(k % 32), k % 7, -(k % 5), 700, 1900) for k in range(len(rows))]
    assert {batch.temperature_raw for batch in batches[20:]} == {0x1234}
    kinds = Counter(type(message).__name__ for _, message in sent)
    assert min(kinds[name] for name in ("Hello", "Health", "Filter", "Mag")) > 10
    *_, last = (m for _, m in sent if isinstance(m, messages.Filter))
    assert last.state == messages.FilterState.TRACKING and last.samples == 2000
