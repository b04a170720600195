"""Identify the source of bytes that contain no frame, with advice for the user."""

from __future__ import annotations

import re

from hubowire.budget import CONSOLE_BAUD, UART_BAUD

_KNOWN_PATTERNS: tuple[tuple[re.Pattern[bytes], str, str], ...] = (
    (
        re.compile(rb"\$G[A-Z]{4},|\$P[A-Z]{3,},"),
        "NMEA text of a GNSS receiver",
        "give this port with --gnss",
    ),
    (
        re.compile(rb">>> |MicroPython v|raw REPL; CTRL-B|Traceback \(most recent call last\)"),
        "a MicroPython prompt: the node's program is not running",
        "reset the node, or install the firmware with `hubodo flash`",
    ),
    (
        re.compile(rb"rst:0x|ets [A-Z][a-z]{2} |ESP-ROM:|boot:0x"),
        "boot messages of an ESP32 that does not reach its program",
        "install the firmware with `hubodo flash`",
    ),
    (
        re.compile(rb"\xb5\x62[\x01-\x30]"),
        "u-blox binary messages",
        "switch the receiver to NMEA and use --gnss",
    ),
)


def is_recognised(data: bytes) -> bool:
    """Return True if the bytes match a known pattern, such as NMEA or a boot message."""
    return any(pattern.search(data) for pattern, _, _ in _KNOWN_PATTERNS)


def describe_foreign_bytes(data: bytes, count: int) -> str:
    """Return what `count` bytes without a frame look like and what to do.

    data: the first of these bytes.
    """
    for pattern, what, remedy in _KNOWN_PATTERNS:
        if pattern.search(data):
            return f"{what}; {remedy}"
    text = sum(32 <= byte < 127 or byte in b"\r\n\t" for byte in data)
    if data and text > 0.9 * len(data):
        sample = data.decode("ascii", "replace").strip().splitlines()
        return f"text such as {sample[0][:40] if sample else ''!r}; this is not a wheel node"
    return (
        f"{count} bytes, no frame; is the baud rate correct (--baud: {UART_BAUD} for the UART of a node, "
        f"{CONSOLE_BAUD} for the console of an ESP32), and is this the correct device?"
    )
