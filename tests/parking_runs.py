"""Run nodes that fall asleep and wake up, and count the samples of their chips that were not sent."""

from dataclasses import dataclass

import numpy as np

from hubodo.earth import STANDARD_GRAVITY
from hubodo.emulator.board.settings import BoardSettings, SensorBoard
from hubodo.emulator.motion import RecordedMotion
from hubodo.ingest.node.decoder import NodeDecoder
from hubodo.ingest.node.gaps import LinkCounts
from hubodo.log.records import ImuBlock
from hubowire import messages as m
from virtual_runs import match_samples, messages_of, run

WAKE_PINS = {"pico": 6, "esp32": 4, "esp32_s3": 4, "esp32_c3": 0}
UARTS = {"pico": 0, "esp32": 2, "esp32_s3": 1, "esp32_c3": 1}
PARK_AFTER_S = 1
CYCLE_S, MOTION_S = 9.0, 1.5
SLOW_PERIOD_S = 0.03
"""Periods of the chip above this are those of its sleep."""
HISTORY_S = {"lsm6dsv": 2.0}
"""The samples of this time before a wake-up have to be sent."""


@dataclass(frozen=True)
class ParkingRun:
    """Result of a run.

    lost: samples that were neither sent nor older than HISTORY_S at a wake-up. delays: time from the start of
    each motion to the first sample at full rate, s. stamp_errors: time errors of the samples at the slow
    rate, us. decoder, device_s: decoder of a host that received everything, and its sample times, s.
    """

    falls_asleep: int
    sent: int
    lost: int
    delays: np.ndarray
    stamp_errors: np.ndarray
    healths: list[m.Health]
    hellos: list[m.Hello]
    light_sleeps: int
    decoder: NodeDecoder
    device_s: np.ndarray


def interrupted_standstill(cycles, seed, jolt=6.0):
    """Return a motion with distinct samples, at rest except for `cycles` drives, and their starts, s."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, cycles * CYCLE_S + 2.0, 0.0012)
    starts = np.array([k * CYCLE_S + CYCLE_S - MOTION_S - rng.random() for k in range(cycles)])
    since = t - starts[np.clip(np.searchsorted(starts, t, side="right") - 1, 0, None)]
    moving = (since >= 0) & (since < MOTION_S)
    gyro = np.radians(rng.uniform(-1.0, 1.0, (len(t), 3)))
    force = rng.uniform(-0.02, 0.02, (len(t), 3)) * STANDARD_GRAVITY + [0.0, 0.0, STANDARD_GRAVITY]
    wave = np.sin(2 * np.pi * 4.0 * since)[:, None]
    gyro[moving] += wave[moving] * [0.5, 0.3, 3.0]
    force[moving] += wave[moving] * [jolt, 0.3 * jolt, 0.0]
    return RecordedMotion(t, gyro, force, temperature_c=25.0, start=0.0), starts


def park(
    cycles,
    *,
    chip="lsm6dso",
    wired=True,
    seed=1,
    interpreter="cpython",
    model="pico",
    rate_hz=416,
    **settings,
):
    """Run a node through `cycles` sleeps and wake-ups; wired: True if INT1 is wired to a pin."""
    wake_pin = WAKE_PINS[model]
    motion, starts = interrupted_standstill(cycles, seed)
    config = {"link": "uart", "park_after_s": PARK_AFTER_S, "rate_hz": rate_hz}
    if wired:
        config["pins"] = {"wake": wake_pin}
    sent, truth, stats = run(
        cycles * CYCLE_S + 1.0,
        motion=motion,
        config=config,
        sensors=SensorBoard(chip, interrupt_pin=wake_pin),
        board=BoardSettings(interpreter=interpreter, uart_link=UARTS[model], model=model),
        **settings,
    )
    decoder = NodeDecoder("left")
    items = [
        item
        for k, (frame, _) in enumerate(sent)
        for item in decoder.decode_frame(frame, k * 20_000_000, LinkCounts())
    ] + list(decoder.close())
    rows = match_samples(sent, truth)
    period = np.diff(truth.t, append=truth.t[-1])
    slow = period > SLOW_PERIOD_S
    missing = np.ones(len(truth.t), dtype=bool)
    missing[rows[:, 0].astype(int)] = False
    # Samples of the last batch are in the chip when the run ends.
    missing[int(rows[-1, 0]) :] = False
    ends = truth.t[np.flatnonzero(slow[:-1] & ~slow[1:])]
    following = np.searchsorted(ends, truth.t)
    until_end = np.append(ends, np.inf)[following] - truth.t
    lost = missing & ~(slow & (until_end > HISTORY_S.get(chip, 4.0)))
    first_fast = truth.t[np.flatnonzero(slow[:-1] & ~slow[1:]) + 1]
    delays = np.array(
        [first_fast[first_fast > start].min() - start for start in starts if (first_fast > start).any()]
    )
    return ParkingRun(
        falls_asleep=int(np.count_nonzero(~slow[:-1] & slow[1:])),
        sent=len(rows),
        lost=int(np.count_nonzero(lost)),
        delays=delays,
        stamp_errors=rows[slow[rows[:, 0].astype(int)], 1],
        healths=messages_of(sent, m.Health),
        hellos=messages_of(sent, m.Hello),
        decoder=decoder,
        device_s=np.concatenate([block.device_ns for block in items if isinstance(block, ImuBlock)]) * 1e-9,
        light_sleeps=stats["counts"].get("light_sleeps", 0),
    )
