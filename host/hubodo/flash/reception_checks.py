"""Evaluation of the data received from a port: protocol, sensor, power, samples, clock and link."""

from __future__ import annotations

import numpy as np

from hubodo.earth import STANDARD_GRAVITY
from hubodo.flash.check_result import CheckResult, failed_check, passed_check, unknown_check
from hubodo.flash.reception import Reception
from hubodo.flash.wiring import describe_device
from hubodo.ingest.node.identity import part_name
from hubowire.messages import Board, Fault, Health, Hello, ResetCause, node_name

SAMPLE_RATE_TOLERANCE = 0.12
"""Relative tolerance of the sample rate: sensor oscillators vary by up to 10 %, plus measurement error."""
_GRAVITY_TOLERANCE = 0.1
_MAX_STATIC_GYRO_STD, _MAX_STATIC_ACCEL_STD = np.radians(3.0), 0.6  # rad/s, m/s²; exceeded in the hand
_MAX_ZERO_RATE = np.radians(25.0)  # rad/s; data sheets: 10 to 20 deg/s, plus noise
_TEMPERATURE_RANGE_DEGC = (-20.0, 70.0)
_MAX_CLOCK_ERROR_PPM = 500.0
_MIN_EXCHANGES, _MIN_SAMPLES = 8, 50


def check_reception(reception: Reception, baud: int) -> list[CheckResult]:
    """Return the checks that need no prompt, as far as the received data allow."""
    protocol = check_protocol(reception, baud)
    if not reception.n_frames:
        return [protocol]
    if reception.mismatch is not None:
        return [
            protocol,
            failed_check(
                "identification", reception.mismatch.partition(": ")[0], "hubodo flash PORT, from this host"
            ),
        ]
    hello, health = reception.hello, reception.reports[-1] if reception.reports else None
    if hello is None:
        return [
            protocol,
            failed_check(
                "identification",
                "frames, but no identification",
                "listen longer with --seconds 15; then hubodo flash",
            ),
        ]
    results = [protocol, _hello(reception, hello), _sensor(hello, health)]
    if health is not None:
        results.append(_power(hello, health))
    results.append(_samples(reception, hello, health))
    if sum(len(block.gyro) for block in reception.blocks) >= _MIN_SAMPLES:
        results.append(_standstill(reception))
    return [*results, _clock(reception), _link(reception, health)]


def check_protocol(reception: Reception, baud: int) -> CheckResult:
    """Check whether a node, a prompt or something else answers on the port."""
    if reception.disconnection:
        return failed_check("protocol", reception.disconnection, "check plug and cable, then try again")
    if reception.n_frames:
        return passed_check("protocol", f"{reception.n_frames} frames, {reception.n_damaged} damaged")
    if reception.has_prompt:
        return passed_check("protocol", "a MicroPython prompt")
    if not reception.n_bytes:
        remedy = (
            "check for a data cable and MicroPython on the board (with UART or Wi-Fi a node is silent on "
            "USB), press reset and try again"
        )
        return failed_check("protocol", "no data", remedy)
    if b"Traceback" in reception.tail:
        text = reception.tail[reception.tail.rindex(b"Traceback") :].decode(errors="replace").split(">>>")[0]
        return failed_check(
            "protocol", " / ".join(text.split("\r\n"))[:300], "hubodo flash PORT; report it if it persists"
        )
    return failed_check(
        "protocol",
        f"{reception.n_bytes} bytes, but no valid frame",
        f"check the baud rate, here {baud} (--baud; 'baud' in /config.json); or this is no node",
    )


def _hello(reception: Reception, hello: Hello) -> CheckResult:
    board = Board(hello.board).name if hello.board in set(Board) else str(hello.board)
    version = ".".join(map(str, hello.firmware))
    name = node_name(reception.node or 0)
    return passed_check(
        "identification", f"node {name!r}, firmware {version}, board {board}, serial {hello.serial.hex()}"
    )


def _sensor(hello: Hello, health: Health | None) -> CheckResult:
    faults = health.faults if health is not None else 0
    named = ", ".join(_describe_part(*part) for part in hello.parts)
    if faults & Fault.BUS_STUCK:
        return failed_check("sensor", "a bus line is held low", "hubodo doctor PORT --repl shows which")
    if faults & Fault.WRONG_WHO_AM_I:
        return failed_check("sensor", named, "no driver for this chip: use one listed in firmware/README.md")
    if faults & Fault.IMU_MISSING or not hello.gyro_lsb_ndps:
        devices = f"only {named}" if named else "nothing"
        remedy = "check 3V3, GND, SDA, SCL and pull-ups; hubodo doctor PORT --repl tests the lines"
        return failed_check("sensor", f"no IMU answers; {devices} on the bus", remedy)
    if faults & Fault.IMU_SILENT:
        return failed_check(
            "sensor", f"{named}, but no samples", "power-cycle the board; then try another chip"
        )
    return passed_check("sensor", named)


def _describe_part(address: int, who_am_i: int, number: int) -> str:
    name = part_name(address, who_am_i, number)
    if name == "unknown":
        return describe_device(address, who_am_i)
    return f"{name} at 0x{address:02X}" if address else f"{name} on SPI"


def _power(hello: Hello, health: Health) -> CheckResult:
    supply = f"{health.battery_mv / 1000:.2f} V" if health.battery_mv else "supply not measured on this board"
    if health.faults & Fault.LOW_BATTERY:
        return failed_check(
            "power", f"{supply}: low", "charge the battery; or another 'low_battery_mv' in /config.json"
        )
    cause = ResetCause(hello.reset_cause) if hello.reset_cause in set(ResetCause) else ResetCause.UNKNOWN
    text = f"{supply}; last start: {cause.name.lower().replace('_', ' ')}"
    if cause == ResetCause.BROWN_OUT:
        return failed_check(
            "power",
            text,
            "the supply voltage dropped: use a shorter cable, another port, or a capacitor at 3V3",
        )
    if cause == ResetCause.WATCHDOG:
        return failed_check("power", text, "the program hung for 8 s: report it with a log of hubodo record")
    return passed_check("power", text)


def _samples(reception: Reception, hello: Hello, health: Health | None) -> CheckResult:
    count = sum(len(block.gyro) for block in reception.blocks)
    nominal = hello.rate_mhz / 1000
    if count < _MIN_SAMPLES:
        return failed_check(
            "samples", f"{count} samples", "see 'sensor'; a stopped node continues after reset"
        )
    times = np.concatenate([block.device_ns for block in reception.blocks])
    rate = (len(times) - 1) / (times[-1] - times[0]) * 1e9
    text = f"{rate:.1f} Hz of {nominal:.0f} Hz, {count} samples, {reception.counts.samples_lost} lost"
    if reception.counts.samples_lost:
        remedy = "use shorter sensor wires, one supply, or a lower 'rate_hz'; hubodo info counts errors"
        return failed_check("samples", text, remedy)
    if abs(rate / nominal - 1) > SAMPLE_RATE_TOLERANCE:
        return failed_check(
            "samples", text, "the chip is a clone, or the board's clock is wrong: see 'clock'"
        )
    if health is not None and health.faults & Fault.POLLED_TOO_FAST:
        remedy = "harmless: remove 'fifo' from /config.json, or set 'rate_hz' to 208 or less"
        return unknown_check("samples", f"{text}; too fast for polling, so the FIFO is used", remedy)
    if health is not None and health.i2c_errors:
        remedy = "shorter wires, stronger pull-ups (4.7 kΩ or 2.2 kΩ); some at power-on are harmless"
        return unknown_check(
            "samples", f"{text}, {health.i2c_errors} transfers failed since the start", remedy
        )
    return passed_check("samples", text)


def _standstill(reception: Reception) -> CheckResult:
    gyro = np.concatenate([block.gyro for block in reception.blocks])
    accel = np.concatenate([block.accel for block in reception.blocks])
    degrees = float(np.median([block.temperature for block in reception.blocks]))
    if gyro.std(axis=0).max() > _MAX_STATIC_GYRO_STD or accel.std(axis=0).max() > _MAX_STATIC_ACCEL_STD:
        return unknown_check(
            "standstill", "the board was moved", "lay it down without touching it, and try again"
        )
    gravity, rate = accel.mean(axis=0), np.degrees(gyro.mean(axis=0))
    size = float(np.linalg.norm(gravity))
    axes = " ".join(f"{value:+.2f}" for value in gravity)
    text = (
        f"gravity {size:.2f} m/s² ({axes}), gyro {' '.join(f'{value:+.2f}' for value in rate)} deg/s, "
        f"{degrees:.1f} °C"
    )
    if abs(size / STANDARD_GRAVITY - 1) > _GRAVITY_TOLERANCE:
        remedy = (
            "an axis is defective, or the scale belongs to another chip: turn it by 90 degrees and repeat"
        )
        return failed_check("standstill", text, remedy)
    if np.abs(rate).max() > np.degrees(_MAX_ZERO_RATE):
        return failed_check("standstill", text, "zero-rate offset beyond all data sheets: replace the chip")
    if not _TEMPERATURE_RANGE_DEGC[0] < degrees < _TEMPERATURE_RANGE_DEGC[1]:
        return failed_check(
            "standstill", text, "implausible temperature scale, possibly a clone; its id is under 'sensor'"
        )
    return passed_check("standstill", text)


def _clock(reception: Reception) -> CheckResult:
    if len(reception.exchanges) < _MIN_EXCHANGES:
        return unknown_check(
            "clock",
            f"{len(reception.exchanges)} answers to requests",
            "the node does not receive from the host",
        )
    third = max(2, len(reception.exchanges) // 3)
    first, last = (
        min(part, key=lambda e: e[2]) for part in (reception.exchanges[:third], reception.exchanges[-third:])
    )
    seconds = (last[0] - first[0]) * 1e-9
    drift = ((last[1] - first[1]) / (last[0] - first[0]) - 1) * 1e6
    # The node read its clock at an unknown time within each round trip.
    bound_ppm = (first[2] + last[2]) / 2 / seconds * 1e-3
    text = f"{drift:+.0f} ± {bound_ppm:.0f} ppm against this host's, over {seconds:.1f} s"
    if abs(drift) > _MAX_CLOCK_ERROR_PPM + bound_ppm:
        return failed_check(
            "clock", text, "beyond a crystal: a board without crystal, or an error of the host clock"
        )
    return passed_check("clock", text)


def _link(reception: Reception, health: Health | None) -> CheckResult:
    first = reception.reports[0] if reception.reports else None
    dropped = health.frames_dropped - first.frames_dropped if health and first else 0
    damaged_at_node = health.frames_damaged - first.frames_damaged if health and first else 0
    lost = reception.counts.frames_lost
    text = f"{lost} frames lost, {reception.n_damaged} damaged, {dropped} dropped by node"
    if dropped:
        return failed_check(
            "link", text, "the link is too slow: use a higher baud rate, USB, or a lower 'rate_hz'"
        )
    # The first frame may have started before the port was opened.
    if reception.n_damaged > 1 or damaged_at_node:
        remedy = "use a shorter cable with GND beside TX and RX, 3.3 V on both sides, or a lower 'baud'"
        return failed_check("link", f"{text}, {damaged_at_node} on the way to the node", remedy)
    return passed_check("link", text)
