"""What a sample costs: instructions counted on CPython, compared with the table in firmware/README.md."""

import importlib.util
import re
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import bias_choice
import bias_filter
import framing
import link
import numpy as np
import pseudo_filter
import pytest
import settings
import small_float
import wire
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


def instructions(rounds, work, native=()):
    """CPython instructions in the firmware for one of `rounds` calls of `work`."""
    counter = Counter(native)
    sys.settrace(counter)
    try:
        for _ in range(rounds):
            work()
    finally:
        sys.settrace(None)
    return counter.count / rounds


def estimation_costs():
    """{what: [instructions plain, with native twins]} of a sample, or of the end of a stretch."""
    rng = np.random.default_rng(1)
    count, turn = 800, 2 * np.pi / 500 * np.arange(800)
    table = np.round(rng.normal((0, 0, 0, 0, 0, 0), 3.0, (count, 6)))
    table[:, 3:5] += 2000 * np.column_stack([np.cos(turn), -np.sin(turn)])
    table[:, 2] += 2138
    moving = table.astype(int).reshape(-1).tolist()
    resting = np.round(rng.normal((3, 2, 1, 0, 0, 2049), 1.5, (count, 6))).astype(int).reshape(-1).tolist()
    clock = SimpleNamespace(period_ns=4_807_692)

    def filtering(kind, native):
        estimator = bias_choice.estimator({**settings.DEFAULTS, "filter_kind": kind})
        for axis in range(3):
            estimator.begin(axis, 0)
        estimator.update(moving, 0, 8)
        return instructions(50, lambda: estimator.update(moving, 48, 8), native) / 8

    def starting(kind, values):
        init = bias_choice.initialisation(
            {**settings.DEFAULTS, "bias_kind": kind, "bias_stretch": 1024}, clock
        )
        init.begin(60_000, 70_000_000, 488_000)
        init.update(values, 0, 8)
        return instructions(50, lambda: init.update(values, 48, 8)) / 8

    known = pseudo_filter.PseudoFilter()
    known.begin(small_float.number(5000, 0), small_float.number(1, -4))
    mean, doubt = [value << 14 for value in moving[:3]], small_float.number(1, -2)
    floats = tuple(f"{name}_plain" for name in ("number", "integer", "times", "plus", "over"))

    def updating(native):
        return instructions(20, lambda: known.update(mean, 2138 << 14, doubt), native)

    return {
        "filter: Kalman": [filtering(wire.FILTER_KIND_KALMAN, twins) for twins in ((), ("kalman_plain",))],
        "filter: RLS": [filtering(wire.FILTER_KIND_RLS, twins) for twins in ((), floats)],
        "initialisation: mean": [starting(wire.BIAS_KIND_MEAN, resting)] * 2,
        "initialisation: rest": [starting(wire.BIAS_KIND_REST, resting)] * 2,
        "initialisation: table": [starting(wire.BIAS_KIND_TABLE, moving)] * 2,
        "initialisation: gravity": [starting(wire.BIAS_KIND_GRAVITY, moving)] * 2,
        "and at the end of each stretch": [updating(()), updating(floats)],
    }


def test_the_costs_of_estimating_in_the_readme_are_what_is_counted():
    readme = (ROOT / "firmware" / "README.md").read_text()
    assert small_float.times is small_float.times_plain, "CPython runs the plain versions"
    for what, (plain, native) in estimation_costs().items():
        print(f"| {what} | {round(plain)} | {round(native)} |")
        stated = re.search(rf"^\| {what} \| (\d+) \| (\d+) \|", readme, re.MULTILINE)
        assert stated, f"{what} is not in the README"
        assert int(stated[1]) == pytest.approx(plain, rel=0.05)
        assert int(stated[2]) == pytest.approx(native, rel=0.05, abs=1)
