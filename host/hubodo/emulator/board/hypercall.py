"""Protocol between interpreter and board: one request and one reply over two pipes."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

REQUEST = struct.Struct("<BxhHHd")
"""Op, interrupt character (-1: none), argument, payload length, time in ns since power-on."""

RESPONSE = struct.Struct("<hBBIdd")
"""Status (count or -errno), flags, reserved, payload length, time of the end of the call in ns, and time up
to which the flags do not change in ns, 0 if unknown."""

MAX_PAYLOAD = 65_000

FLAG_INPUT = 1
"""Input is available on standard input."""
FLAG_ROOM = 2
"""Standard output accepts bytes without blocking."""
FLAG_INTERRUPT = 4
"""The interrupt character was received."""
FLAG_OPEN = 8
"""A host has the port open."""
FLAG_PLUGGED = 16
"""The cable is plugged in, and the terminal exists."""
FLAG_BOARD_OFF = 32
"""Sent instead of a reply: the board is off or restarts, and the interpreter has to stop."""

COUNT_MASK, COUNT_ROOM = 0x3FFF, 0x4000

EIO, EAGAIN, ENODEV, EINVAL, ETIMEDOUT, EHOSTUNREACH = 5, 11, 19, 22, 110, 113


class Op(IntEnum):
    """Calls of the interpreter. The comments give [argument; payload] and the reply."""

    PING = 1
    """Returns the flags only."""
    I2C_INIT = 2
    """[bus; u32 frequency, i8 scl, i8 sda]"""
    I2C_READ_MEM = 3
    """[bus; u8 address, u8 address bytes, u16 register, u16 n] returns n bytes."""
    I2C_WRITE_MEM = 4
    """[bus; u8 address, u8 address bytes, u16 register, data]"""
    I2C_READ = 5
    """[bus; u8 address, u8 0, u16 0, u16 n] returns n bytes."""
    I2C_WRITE = 6
    """[bus; u8 address, u8 0, u16 0, data]"""
    I2C_SCAN = 7
    """[bus] returns one byte for each address that acknowledges."""
    PIN_INIT = 8
    """[pin; u8 mode, i8 pull]; modes 0 in, 1 out, 2 open drain."""
    PIN_SET = 9
    """[pin; u8 level]"""
    PIN_GET = 10
    """[pin] status = level."""
    ADC_READ = 11
    """[channel] returns u16."""
    WDT = 12
    """[0 feed, 1 start; u32 ms]"""
    RESET = 13
    """Hard reset of the processor; without reply."""
    WRITE = 14
    """[port; bytes] port 0 = standard output, k + 1 = UART k; status = bytes accepted."""
    READ = 15
    """[port; u32 limit, i32 timeout for the first byte in ms, -1 = infinite] returns bytes."""
    COUNT = 16
    """[port] status = available bytes, up to COUNT_MASK, | COUNT_ROOM if writable.

    [256 | handle] 1 if a datagram is available."""
    UART_INIT = 17
    """[port; u32 baud, u16 send buffer, u16 receive buffer]"""
    WLAN = 18
    """[0 off, 1 on, 2 connect, 3 disconnect, 4 status, 5 is connected, 0x100 + 1 + reconnects]"""
    UDP_OPEN = 19
    """status = handle."""
    UDP_BIND = 20
    """[handle; u16 port]"""
    UDP_SEND = 21
    """[handle; u8 4 IPv4, u16 port, bytes] status = bytes sent."""
    UDP_RECV = 22
    """[handle; u32 limit, i32 timeout in ms] returns u8 4 IPv4, u16 port, bytes."""
    UDP_CLOSE = 23
    """[handle]"""
    SOFT_RESET = 25
    """[1 = raw prompt] Restart of the interpreter; without reply."""
    IDLE = 24
    """main.py has ended; the prompt follows."""
    RESTARTED = 26
    """[cause: 0 unknown, 1 watchdog, 2 machine.reset] The emulated processor has restarted."""
    I2C_START = 27
    """[bus; u8 address, u8 read, bytes written since the previous start] status 1: acknowledged."""
    I2C_PUT = 28
    """[bus; bytes written since the previous start] End of the transfer."""
    I2C_TAKE = 29
    """[bus] status = byte that the chip sends."""
    METER = 30
    """[; JSON] Activity profile of the processor."""
    SPI = 31
    """[unit; bytes] returns the bytes received meanwhile."""
    ESPNOW = 32
    """[-; u8 call, arguments] ESP-NOW call, see `chips.espnow`."""
    BLE = 34
    """[-; u8 call, arguments] Bluetooth call, see `chips.ble_peripheral`."""
    LIGHT_SLEEP = 33
    """[pin + 1, 0: none; u32 ms] Sleep until a rising edge of the pin: status 1; or for that time: 0."""


def op_codes() -> dict[str, int]:
    """Return the op codes by name, for the runners."""
    return {op.name: int(op) for op in Op}


class Reply(NamedTuple):
    """Reply to a call that ends at `t` ns."""

    t: float
    status: int = 0
    payload: bytes = b""


@dataclass(frozen=True)
class Deferred:
    """A call with a delayed reply: `poll_reply(late)` returns the reply, or None while it is pending."""

    timeout_ns: float
    poll_reply: Callable[[bool], Reply | None]


Handler = Callable[[int, bytes, float], Reply | Deferred | None]
"""Function of the argument, the payload and the time in ns that serves a call; None: without reply."""
