"""How the interpreter asks the board: one request, one answer, over two pipes."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

REQUEST = struct.Struct("<BxhHHd")
"""op, interrupt character (-1 = none), a, payload length, time in ns since the board was switched on."""

RESPONSE = struct.Struct("<hBBIdd")
"""Status (count or -errno), flags, spare, payload length, time in ns at which the call is over, and time in
ns up to which nothing happens that the interpreter would have to ask for: 0 where that is not known."""

MAX_PAYLOAD = 65_000

FLAG_INPUT = 1
"""Bytes wait on standard input."""
FLAG_ROOM = 2
"""Standard output takes bytes without waiting."""
FLAG_INTERRUPT = 4
"""The interrupt character came in."""
FLAG_OPEN = 8
"""A host has the port open."""
FLAG_PLUGGED = 16
"""The cable is in, the terminal there."""
FLAG_OVER = 32
"""Instead of an answer: the board is off or restarts, nothing more happens here."""

COUNT_MASK, COUNT_ROOM = 0x3FFF, 0x4000

EIO, EAGAIN, ENODEV, EINVAL, ETIMEDOUT, EHOSTUNREACH = 5, 11, 19, 22, 110, 113


class Op(IntEnum):
    """What can be asked; `a` and the payload in brackets."""

    PING = 1
    """Nothing but the flags."""
    I2C_INIT = 2
    """[bus; u32 frequency, i8 scl, i8 sda]"""
    I2C_READ_MEM = 3
    """[bus; u8 address, u8 address bytes, u16 register, u16 n] answers n bytes."""
    I2C_WRITE_MEM = 4
    """[bus; u8 address, u8 address bytes, u16 register, data]"""
    I2C_READ = 5
    """[bus; u8 address, u8 0, u16 0, u16 n] answers n bytes."""
    I2C_WRITE = 6
    """[bus; u8 address, u8 0, u16 0, data]"""
    I2C_SCAN = 7
    """[bus] answers one byte for each address that acknowledges."""
    PIN_INIT = 8
    """[pin; u8 mode, i8 pull]; modes 0 in, 1 out, 2 open drain."""
    PIN_SET = 9
    """[pin; u8 level]"""
    PIN_GET = 10
    """[pin] status = level."""
    ADC_READ = 11
    """[channel] answers u16."""
    WDT = 12
    """[0 feeds, 1 starts; u32 ms]"""
    RESET = 13
    """Hard reset of the processor; no answer comes."""
    WRITE = 14
    """[port; bytes] port 0 = standard output, k + 1 = UART k; status = taken."""
    READ = 15
    """[port; u32 most, i32 ms to wait for the first byte, -1 = for ever] answers bytes."""
    COUNT = 16
    """[port] status = bytes waiting, to COUNT_MASK, | COUNT_ROOM; [256 | handle] 1 when a datagram waits."""
    UART_INIT = 17
    """[port; u32 baud, u16 send buffer, u16 receive buffer]"""
    WLAN = 18
    """[0 off, 1 on, 2 connect, 3 disconnect, 4 status, 5 is it connected, 0x100 + 1 + reconnects]"""
    UDP_OPEN = 19
    """status = handle."""
    UDP_BIND = 20
    """[handle; u16 port]"""
    UDP_SEND = 21
    """[handle; u8 4 IPv4, u16 port, bytes] status = sent."""
    UDP_RECV = 22
    """[handle; u32 most, i32 ms] answers u8 4 IPv4, u16 port, bytes."""
    UDP_CLOSE = 23
    """[handle]"""
    SOFT_RESET = 25
    """[1 = the prompt was raw] The interpreter begins anew; no answer comes."""
    IDLE = 24
    """main.py is over; the prompt comes next."""
    RESTARTED = 26
    """[why: 0 nobody knows, 1 watchdog, 2 machine.reset] The emulated processor has begun anew."""
    I2C_START = 27
    """[bus; u8 address, u8 reading, bytes written since the start before] status 1: acknowledged."""
    I2C_PUT = 28
    """[bus; bytes written since the start before] The transfer ends."""
    I2C_TAKE = 29
    """[bus] status = the byte that the chip shows."""
    METER = 30
    """[; JSON] What the processor did so far."""
    SPI = 31
    """[unit; bytes] answers as many bytes: what came in while these went out."""
    ESPNOW = 32
    """[-; u8 what, its arguments] of ESP-NOW; answers what was asked for, see `chips.espnow`."""


def op_codes() -> dict[str, int]:
    """The op codes by name, as the runners get them."""
    return {op.name: int(op) for op in Op}


class Reply(NamedTuple):
    """What the board says to a call that is over at `t` ns."""

    t: float
    status: int = 0
    payload: bytes = b""


@dataclass(frozen=True)
class Deferred:
    """A call that has to wait: `finished(late)` gives its answer once it can, at the latest when late."""

    timeout_ns: float
    finished: Callable[[bool], Reply | None]


Handler = Callable[[int, bytes, float], Reply | Deferred | None]
"""What a call does, from `a`, the payload and the time in ns; None: no answer comes."""
