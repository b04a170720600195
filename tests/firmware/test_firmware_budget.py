"""What a sample costs: instructions counted on CPython, compared with the table in firmware/README.md."""

import importlib.util
import re
import sys
import time
from pathlib import Path

import bias_filter
import framing
import link
import pytest
from outbox import Outbox
from sampler import Sampler

from fakes.fake_port import PORT_TICKS

ROOT = Path(__file__).parents[2]
FIRMWARE = str(ROOT / "firmware")
SAMPLES = 480


def fake_bus(imu, period_us):
    path = ROOT / "tests" / "fakes" / "micropython" / "fake_bus.py"
    spec = importlib.util.spec_from_file_location("fake_bus", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.FakeBus(imu, period_us)


class FakeLink(link.Link):
    """Takes everything in chunks of 64 bytes, as USB does."""

    MOST = 64

    def _take(self, raw, at, size):
        return size


class Counter:
    """Counts the instructions that CPython executes in files of the firmware; `native` ones are left out."""

    def __init__(self, native=()):
        self.count = 0
        self._native = native

    def __call__(self, frame, event, argument):
        code = frame.f_code
        if not code.co_filename.startswith(FIRMWARE) or code.co_name in self._native:
            return None
        frame.f_trace_opcodes = True
        if event == "opcode":
            self.count += 1
        return self


def instructions_per_sample(rate, native):
    """(instructions, I2C microseconds, link bytes) for one sample, over many."""
    from drivers.lsm6ds33 import LSM6DS33

    period_us = 1_000_000 // rate
    bus = fake_bus("lsm6ds33", period_us)
    estimator = bias_filter.KalmanFilter(314_573, 322)
    outbox, sink = Outbox(24, 1), FakeLink()
    chip = LSM6DS33(bus, odr_hz=rate)
    batch = 16 if chip.uses_fifo else 8
    outbox.shape(batch)
    sampler = Sampler(outbox, estimator.update)
    sampler.begin(time.ticks_us(), chip, batch, False)
    sent, wire = [0], [0.0]
    took, read = outbox.took, bus.readfrom_mem_into

    def count_bytes(size):
        sent[0] += size
        took(size)

    def count_wire(address, register, buffer):
        # Start, address, register, start, address, data, stop: nine clocks a byte at 400 kHz.
        wire[0] += (9 * (3 + memoryview(buffer).nbytes) + 3) / 0.4
        read(address, register, buffer)

    def until(index):
        while sampler.clock.index < index:
            ahead = time.ticks_diff(sampler.due_us, time.ticks_us())
            PORT_TICKS.sleep_us(max(ahead, 0) + 30)
            sampler.turn(time.ticks_us())
            sink.send(outbox, 4)

    outbox.took, bus.readfrom_mem_into = count_bytes, count_wire
    until(rate)
    first, sent[0], wire[0] = sampler.clock.index, 0, 0.0
    counter = Counter(native)
    sys.settrace(counter)
    try:
        until(first + SAMPLES)
    finally:
        sys.settrace(None)
    done = sampler.clock.index - first
    return counter.count / done, wire[0] / done, sent[0] / done


def table_of_readme():
    rows = re.findall(
        r"^\| (\d+) Hz \| (\d+) us \| (\d+) us \| (\d+) \| (\d+) \| (\d+) \|",
        (ROOT / "firmware" / "README.md").read_text(),
        re.MULTILINE,
    )
    return {int(row[0]): tuple(map(int, row[1:])) for row in rows}


@pytest.mark.parametrize("rate", [208, 416, 833, 1660])
def test_the_budget_in_the_readme_is_what_is_counted(rate):
    plain, wire_us, sent = instructions_per_sample(rate, ())
    native, _, _ = instructions_per_sample(rate, ("kalman_plain", "crc16_table"))
    cells = [round(value) for value in (1e6 / rate, wire_us, plain, native, sent * rate)]
    print("| {} Hz | {} us | {} us | {} | {} | {} |".format(rate, *cells))
    period, stated_wire, stated_plain, stated_native, stated_bytes = table_of_readme()[rate]
    assert period == round(1e6 / rate)
    assert stated_wire == pytest.approx(wire_us, rel=0.05)
    assert stated_plain == pytest.approx(plain, rel=0.05)
    assert stated_native == pytest.approx(native, rel=0.05)
    assert stated_bytes == pytest.approx(sent * rate, rel=0.02)
    assert framing.crc16 is framing.crc16_table, "CPython runs the plain versions"
