"""What was heard from a port, judged: does a node speak, what is on its bus, what are its samples worth."""

from __future__ import annotations

import numpy as np

from hubodo.earth import STANDARD_GRAVITY
from hubodo.flash.check_result import CheckResult, ok, unknown, wrong
from hubodo.flash.listen import Heard
from hubodo.flash.wires import chip_name
from hubowire.messages import Board, Fault, Health, Hello, Part, ResetCause, node_name

RATE_TOLERANCE = 0.12
"""Of the chip's own oscillator: 10 % is seen, and what the node's measuring adds."""
_GRAVITY_TOLERANCE = 0.1
_STILL_GYRO, _STILL_ACCEL = np.radians(3.0), 0.6  # 1 sigma that a hand does not keep below
_ZERO_RATE = np.radians(25.0)  # data sheets: 10 to 20 deg/s, and the noise of a short look
_TEMPERATURES = (-20.0, 70.0)
_DRIFT_PPM = 500.0
_LEAST_EXCHANGES, _LEAST_SAMPLES = 8, 50


def judge(heard: Heard, baud: int) -> list[CheckResult]:
    """The checks that need no look from within, as far as what was heard goes."""
    said = speech(heard, baud)
    if not heard.frames:
        return [said]
    if heard.refusal is not None:
        return [said, wrong("hello", heard.refusal.partition(": ")[0], "hubodo flash PORT, from this host")]
    hello, health = heard.hello, heard.reports[-1] if heard.reports else None
    if hello is None:
        return [
            said,
            wrong("hello", "frames, but no Hello", "listen longer: --seconds 15; then hubodo flash"),
        ]
    results = [said, _hello(heard, hello), _sensor(hello, health)]
    if health is not None:
        results.append(_power(hello, health))
    results.append(_samples(heard, hello, health))
    if sum(len(block.gyro) for block in heard.blocks) >= _LEAST_SAMPLES:
        results.append(_rest(heard))
    return [*results, _clock(heard), _link(heard, health)]


def speech(heard: Heard, baud: int) -> CheckResult:
    """Whether anything speaks, and what."""
    if heard.gone:
        return wrong("speech", heard.gone, "look at plug and cable; then try again")
    if heard.frames:
        return ok("speech", f"{heard.frames} frames, {heard.damaged} damaged")
    if heard.prompt:
        return ok("speech", "a MicroPython prompt")
    if not heard.received:
        remedy = (
            "a data cable? MicroPython on the board? A node that sends by UART or Wi-Fi is silent on USB; "
            "press reset and try again"
        )
        return wrong("speech", "silence", remedy)
    if b"Traceback" in heard.tail:
        text = heard.tail[heard.tail.rindex(b"Traceback") :].decode(errors="replace").split(">>>")[0]
        return wrong("speech", " / ".join(text.split("\r\n"))[:300], "hubodo flash PORT; tell us if it stays")
    return wrong(
        "speech",
        f"{heard.received} bytes, but not one frame",
        f"another baud rate than {baud} (--baud; 'baud' in /config.json), or not a node",
    )


def _hello(heard: Heard, hello: Hello) -> CheckResult:
    board = Board(hello.board).name if hello.board in set(Board) else str(hello.board)
    version = ".".join(map(str, hello.firmware))
    name = node_name(heard.node or 0)
    return ok("hello", f"node {name!r}, firmware {version}, board {board}, serial {hello.serial.hex()}")


def _sensor(hello: Hello, health: Health | None) -> CheckResult:
    faults = health.faults if health is not None else 0
    parts = [(address, identity, part) for address, identity, part in hello.parts]
    named = ", ".join(
        f"{Part(part).name} at 0x{address:02X}" if part in set(Part) else chip_name(address, identity)
        for address, identity, part in parts
    )
    if faults & Fault.BUS_STUCK:
        return wrong("sensor", "a line of the bus is held low", "hubodo doctor PORT --repl says which")
    if faults & Fault.WRONG_WHO_AM_I:
        return wrong("sensor", named, "no driver for this chip: use one that firmware/README.md names")
    if faults & Fault.IMU_MISSING or not hello.gyro_lsb_ndps:
        there = f"only {named}" if named else "nothing"
        remedy = (
            "3V3, GND, SDA, SCL to the sensor board, pull-ups; hubodo doctor PORT --repl looks at the lines"
        )
        return wrong("sensor", f"no IMU answers; {there} is on the bus", remedy)
    if faults & Fault.IMU_SILENT:
        return wrong("sensor", f"{named}, but no samples", "take the power off and on; then another chip")
    return ok("sensor", named)


def _power(hello: Hello, health: Health) -> CheckResult:
    supply = f"{health.battery_mv / 1000:.2f} V" if health.battery_mv else "supply not measured on this board"
    if health.faults & Fault.LOW_BATTERY:
        return wrong(
            "power", f"{supply}: low", "charge the battery; or another 'low_battery_mv' in /config.json"
        )
    cause = ResetCause(hello.reset_cause) if hello.reset_cause in set(ResetCause) else ResetCause.UNKNOWN
    words = f"{supply}; last start: {cause.name.lower().replace('_', ' ')}"
    if cause == ResetCause.BROWN_OUT:
        return wrong("power", words, "the supply dipped: shorter cable, another port, a capacitor at 3V3")
    if cause == ResetCause.WATCHDOG:
        return wrong("power", words, "the program hung for 8 s: tell us, with a log of hubodo record")
    return ok("power", words)


def _samples(heard: Heard, hello: Hello, health: Health | None) -> CheckResult:
    count = sum(len(block.gyro) for block in heard.blocks)
    nominal = hello.rate_mhz / 1000
    if count < _LEAST_SAMPLES:
        return wrong(
            "samples", f"{count} samples", "see 'sensor'; a node that was stopped goes on after reset"
        )
    times = np.concatenate([block.device_ns for block in heard.blocks])
    rate = (len(times) - 1) / (times[-1] - times[0]) * 1e9
    text = f"{rate:.1f} Hz of {nominal:.0f} Hz, {count} samples, {heard.counts.samples_lost} lost"
    if heard.counts.samples_lost:
        remedy = (
            "shorter wires to the sensor, one supply; a lower 'rate_hz'; errors are counted by hubodo info"
        )
        return wrong("samples", text, remedy)
    if abs(rate / nominal - 1) > RATE_TOLERANCE:
        return wrong("samples", text, "the chip is a clone, or the board's clock is wrong: see 'clock'")
    if health is not None and health.faults & Fault.POLLED_TOO_FAST:
        remedy = "harmless: take 'fifo' out of /config.json, or lower 'rate_hz' to 208 or less"
        return unknown("samples", f"{text}; too fast to be polled, so they come through the FIFO", remedy)
    if health is not None and health.i2c_errors:
        remedy = "shorter wires, stronger pull-ups (4.7 kΩ or 2.2 kΩ); some at start are harmless"
        return unknown("samples", f"{text}, {health.i2c_errors} transfers failed since the start", remedy)
    return ok("samples", text)


def _rest(heard: Heard) -> CheckResult:
    gyro = np.concatenate([block.gyro for block in heard.blocks])
    accel = np.concatenate([block.accel for block in heard.blocks])
    degrees = float(np.median([block.temperature for block in heard.blocks]))
    if gyro.std(axis=0).max() > _STILL_GYRO or accel.std(axis=0).max() > _STILL_ACCEL:
        return unknown("rest", "it was moved", "lay it down, do not touch it, and try again")
    gravity, rate = accel.mean(axis=0), np.degrees(gyro.mean(axis=0))
    size = float(np.linalg.norm(gravity))
    axes = " ".join(f"{value:+.2f}" for value in gravity)
    text = (
        f"gravity {size:.2f} m/s² ({axes}), gyro {' '.join(f'{value:+.2f}' for value in rate)} deg/s, "
        f"{degrees:.1f} °C"
    )
    if abs(size / STANDARD_GRAVITY - 1) > _GRAVITY_TOLERANCE:
        remedy = "an axis is dead, or the scale is that of another chip: turn it by 90 degrees and look again"
        return wrong("rest", text, remedy)
    if np.abs(rate).max() > np.degrees(_ZERO_RATE):
        return wrong("rest", text, "more than any data sheet allows at rest: another chip")
    if not _TEMPERATURES[0] < degrees < _TEMPERATURES[1]:
        return wrong("rest", text, "the thermometer has another scale: a clone? Its id is under 'sensor'")
    return ok("rest", text)


def _clock(heard: Heard) -> CheckResult:
    if len(heard.exchanges) < _LEAST_EXCHANGES:
        return unknown(
            "clock", f"{len(heard.exchanges)} answers to requests", "the node does not hear the host"
        )
    third = max(2, len(heard.exchanges) // 3)
    first, last = (
        min(part, key=lambda e: e[2]) for part in (heard.exchanges[:third], heard.exchanges[-third:])
    )
    seconds = (last[0] - first[0]) * 1e-9
    drift = ((last[1] - first[1]) / (last[0] - first[0]) - 1) * 1e6
    # The node read its clock somewhere within each round trip.
    sure = (first[2] + last[2]) / 2 / seconds * 1e-3
    text = f"{drift:+.0f} ± {sure:.0f} ppm against this host's, over {seconds:.1f} s"
    if abs(drift) > _DRIFT_PPM + sure:
        return wrong("clock", text, "more than a crystal: a board without one, or this host's clock")
    return ok("clock", text)


def _link(heard: Heard, health: Health | None) -> CheckResult:
    first = heard.reports[0] if heard.reports else None
    dropped = health.frames_dropped - first.frames_dropped if health and first else 0
    deaf = health.frames_damaged - first.frames_damaged if health and first else 0
    text = f"{heard.counts.frames_lost} frames lost, {heard.damaged} damaged, {dropped} given up by the node"
    if dropped:
        return wrong("link", text, "the link is too slow: a higher baud rate, USB, or a lower 'rate_hz'")
    # The first frame may have begun before the port was open.
    if heard.damaged > 1 or deaf:
        remedy = "a shorter cable with GND beside TX and RX; both sides 3.3 V; a lower 'baud'"
        return wrong("link", f"{text}, {deaf} on the way to the node", remedy)
    return ok("link", text)
