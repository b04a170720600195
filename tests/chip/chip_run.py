"""Run the firmware on an emulated Pico for some seconds, and compare its output with that of the chip."""

import dataclasses
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hubodo.emulator.board.settings import BoardSettings, Clock, Flash, Host, SensorBoard
from hubodo.emulator.chips.imu import Specimen
from hubodo.emulator.chips.lsm6ds33 import FIFO_DATA_L, FIFO_WORDS
from hubodo.emulator.interpreters.rp2040.image import find_image
from hubodo.emulator.interpreters.rp2040.pico import PicoSettings
from hubodo.emulator.virtual_node import VirtualNode
from hubowire import FrameDecoder, decode
from hubowire import messages as m
from virtual_runs import match_samples, messages_of, unique_motion

FIFO_SAMPLES = FIFO_WORDS // 6
STARTED = 1.5
"""s after power-on: what the processor does is counted from here on."""
SETTLED = 1.0
"""s after the first sample."""
USUAL = PicoSettings()


@dataclass(frozen=True)
class ChipRun:
    """Results of one run. A pair is the minimum and the maximum; None without samples.

    samples: received; lost: of those measured between the first and the last of them; waiting: of those
    measured after the last.
    burst_gap_ms, fifo_share: longest time between two bursts from the FIFO, absolute and relative to its
    capacity. cpu_us: processing per sample, without waits and I2C transfers; cpu_left: share of waiting time.
    allocations: per second of the loop.
    begin_us, later_us: time stamps minus truth, in the first second and after it.
    speed: emulated seconds per second.
    functions: see rp2040/profile.mjs, per second of the loop.
    """

    name: str
    samples: int
    lost: int
    waiting: int
    burst_gap_ms: float | None
    fifo_share: float | None
    cpu_us: float
    cpu_left: float
    allocations: float
    begin_us: tuple[float, float] | None
    later_us: tuple[float, float] | None
    hello_s: float | None
    speed: float
    functions: tuple[dict[str, object], ...] = ()


def run_chip(
    name: str,
    config: dict[str, Any],
    firmware: Path,
    seconds: float,
    *,
    seed: int = 1,
    pico: PicoSettings = USUAL,
    chip: str = "lsm6ds33",
) -> ChipRun:
    """Run `seconds` of emulated time from power-on with `config`; the seed makes the chip up to 2 % fast.

    The times of bursts are those of an LSM6DS33 only.

    Raise ImageMissing and the errors of a virtual node.
    """
    symbols = find_image(pico.image, pico.bootrom).symbols
    odr_error = float(np.random.default_rng(seed).uniform(0.0, 0.02))
    began = time.monotonic()
    node = VirtualNode(
        unique_motion(seconds),
        Flash(firmware, config),
        sensors=SensorBoard(
            chip,
            specimen=Specimen(odr_error),
            log=True,
            select_pin=config.get("pins", {}).get("imu_csn"),
        ),
        board=BoardSettings(
            interpreter="rp2040",
            pico=dataclasses.replace(pico, meter_from=STARTED if symbols is not None else None),
        ),
        clock=Clock("stepped", run_for=seconds),
        host=Host("memory"),
        seed=seed,
    )
    with node:
        node.wait(60 + 30 * seconds)
        took = time.monotonic() - began
        output, arrivals, truth = node.output, node.arrivals(), node.chip.truth()
        reads, meter = node.bus_log(), node.meter()
    sent = [(frame, decode(frame.type_id, frame.payload)) for frame in FrameDecoder().feed(output)]
    n_words = 3 if chip == "bmi088" else 6
    batches = messages_of(sent, m.ImuBatch)
    matches = match_samples(sent, truth, n_words=n_words) if batches else np.zeros((0, 3))
    bursts = np.array([r.t for r in reads if r.register == FIFO_DATA_L and chip == "lsm6ds33"])
    gap = float(np.diff(bursts).max()) if len(bursts) > 1 else None
    rate = (len(truth.t) - 1) / (truth.t[-1] - truth.t[0]) if len(truth.t) > 1 else 0.0
    sample_times = truth.t[matches[:, 0].astype(int)] if len(matches) else np.zeros(0)
    early = sample_times < sample_times[0] + SETTLED if len(sample_times) else np.zeros(0, dtype=bool)
    busy = meter["total_us"] - meter["idle_us"] - meter["transfer_us"] if meter else float("nan")
    return ChipRun(
        name,
        samples=len(matches),
        lost=int((np.diff(matches[:, 0]) - 1).sum()) if len(matches) else len(truth.t),
        waiting=len(truth.t) - 1 - int(matches[-1, 0]) if len(matches) else 0,
        burst_gap_ms=None if gap is None else gap * 1e3,
        fifo_share=None if gap is None else gap * rate / FIFO_SAMPLES,
        cpu_us=busy / (rate * meter["seconds"]) if meter else float("nan"),
        cpu_left=meter["idle_us"] / meter["total_us"] if meter else float("nan"),
        allocations=meter["allocations"] / meter["seconds"] if meter else float("nan"),
        begin_us=_span(matches[early, 1]),
        later_us=_span(matches[~early, 1]),
        hello_s=_hello(output, arrivals),
        speed=seconds / took,
        functions=tuple(_per_second(f, meter["seconds"]) for f in meter.get("functions", ())),
    )


def _span(values):
    return (float(values.min()), float(values.max())) if len(values) else None


def _hello(output, arrivals):
    """Return the time of the last byte of the first Hello, s."""
    decoder, before = FrameDecoder(), 0
    for t, count in arrivals:
        if any(f.type_id == m.Hello.type_id for f in decoder.feed(output[before:count])):
            return t
        before = count
    return None


def _per_second(function, seconds):
    rates = {key: function[key] / seconds for key in ("own_us", "all_us", "calls")}
    return {"name": function["name"], **rates, "heap": function["heap"]}
