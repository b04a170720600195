"""Run the real firmware on the virtual board and compare what it sent with the truth of its chip."""

from dataclasses import replace
from pathlib import Path

import numpy as np

import hubowire
import wanted
from hubodo.emulator.board.settings import Clock, Flash, Host
from hubodo.emulator.interpreters.find import InterpreterMissing
from hubodo.emulator.interpreters.interpreter import check_available
from hubodo.emulator.interpreters.rp2040.image import ImageMissing
from hubodo.emulator.motion import RecordedMotion
from hubodo.emulator.virtual_node import VirtualNode
from hubowire import messages as m

FIRMWARE = Path(__file__).parents[1] / "firmware"
PERIOD = 1 << 30
_CLOCK = Clock()


def micropython_or_skip():
    """Skip the test if Node.js or MicroPython is missing; see `wanted`."""
    try:
        check_available("micropython")
    except InterpreterMissing as missing:
        wanted.lacking(str(missing))


def unique_motion(seconds):
    """Return a motion in which no two samples are equal, so that each sample sent can be identified."""
    t = np.arange(0, seconds + 1, 0.002)
    gyro = np.stack([3 * np.sin(7 * t), 2 * np.cos(3.1 * t), 9 * np.sin(0.9 * t)], axis=1)
    accel = np.stack([5 * np.sin(2.3 * t), 5 * np.cos(4.7 * t), 9 + np.sin(t)], axis=1)
    return RecordedMotion(t, gyro, accel, temperature_c=25.0, start=0.0)


def virtual_node(seconds, motion, flash, *, script=(), host_pauses=(), clock=_CLOCK, **settings):
    """Return a node in virtual time; script: input from its host, host_pauses: when it does not read."""
    return VirtualNode(
        motion,
        flash,
        clock=replace(clock, kind="stepped", run_for=seconds),
        host=Host("memory", script=tuple(script), read_pauses=tuple(host_pauses)),
        own_process=False,
        **settings,
    )


def run(seconds, *, motion=None, config=None, **settings):
    """Run a node; return the (frame, message) pairs sent, the truth of its chip, and statistics."""
    micropython_or_skip()
    with virtual_node(seconds, motion or unique_motion(seconds), Flash(FIRMWARE, config), **settings) as node:
        node.wait(100)
        sent = hubowire.FrameDecoder().feed(node.output)
        return [(f, hubowire.decode(f.type_id, f.payload)) for f in sent], node.chip.truth(), node.stats


def messages_of(sent, kind):
    return [message for _, message in sent if isinstance(message, kind)]


def match_samples(sent, truth, ticks_start_us=0, n_words=6):
    """Return (index in the truth, time error in us, number on the wire) of every sample sent.

    Each sample sent must be one of the chip, in order. n_words: 3 for a BMI088, whose driver interpolates the
    accelerometer.
    """
    known: dict[tuple[int, ...], list[int]] = {}
    for k, row in enumerate(truth.raw.tolist()):
        known.setdefault(tuple(row[:n_words]), []).append(k)
    rows = []
    for batch in messages_of(sent, m.ImuBatch):
        for i, row in enumerate(batch.samples):
            after = rows[-1][0] if rows else -1
            later = [k for k in known.get(tuple(row[:n_words]), ()) if k > after]
            assert later, f"sample {row} was not on the chip after sample {after}"
            k = later[0]
            t_us = batch.t_us + i * batch.period_ns / 1000
            error = (t_us - ticks_start_us - truth.t[k] * 1e6 + PERIOD / 2) % PERIOD - PERIOD / 2
            rows.append((k, error, batch.index + i))
    return np.array(rows)


def count_missing_frames(sent, *, since_boot=False):
    """Count missing frames of all types by sequence number; since_boot: also those before the first."""
    last: dict[int, int] = {frame.type_id: -1 for frame, _ in sent} if since_boot else {}
    lost = 0
    for frame, _ in sent:
        if frame.type_id in last:
            lost += (frame.seq - last[frame.type_id] - 1) & 0xFFFF
        last[frame.type_id] = frame.seq
    return lost


def request(seq, message, node=1):
    return hubowire.encode_frame(hubowire.Frame(message.type_id, node, seq, hubowire.encode(message)))


def pico_or_skip():
    """Skip the test if Node.js, the emulator or the image of MicroPython is missing; see `wanted`."""
    try:
        check_available("rp2040")
    except (InterpreterMissing, ImageMissing) as missing:
        wanted.lacking(str(missing))
