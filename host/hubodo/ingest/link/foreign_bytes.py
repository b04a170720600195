"""Bytes that are no frames: what they look like, in words a user can act on."""

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
    """Whether these bytes tell what they are, however few."""
    return any(pattern.search(data) for pattern, _, _ in _KNOWN_PATTERNS)


def describe_foreign_bytes(data: bytes, count: int) -> str:
    """What came and what to do about it, for `count` bytes in which no frame was found; data: the first."""
    for pattern, what, remedy in _KNOWN_PATTERNS:
        if pattern.search(data):
            return f"{what}; {remedy}"
    text = sum(32 <= byte < 127 or byte in b"\r\n\t" for byte in data)
    if data and text > 0.9 * len(data):
        sample = data.decode("ascii", "replace").strip().splitlines()
        return f"text such as {sample[0][:40] if sample else ''!r}; this port is no wheel node"
    return (
        f"{count} bytes, no frame; is the baud rate right (--baud: a node's UART speaks {UART_BAUD}, the "
        f"console of an ESP32 {CONSOLE_BAUD}), and is this the device?"
    )
