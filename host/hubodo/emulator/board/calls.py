"""What each call of the interpreter does on the board: one function for each `Op`."""

from __future__ import annotations

import json
import select
import socket
import struct
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from hubodo.emulator.board.hypercall import (
    COUNT_MASK,
    COUNT_ROOM,
    EAGAIN,
    EHOSTUNREACH,
    EINVAL,
    ETIMEDOUT,
    Op,
)
from hubodo.emulator.board.link import TX_FIFO
from hubodo.emulator.board.models import RADIO_SELECT_PIN
from hubodo.emulator.board.network import MULTICAST, NAME_SERVER
from hubodo.emulator.board.port import Port

if TYPE_CHECKING:
    from hubodo.emulator.board.board import VirtualBoard

WRITE_TIMEOUT_NS = 500_000_000
BOOT_NS = 150_000_000
JOIN_NS = 50_000_000
"""What the radio's commands of a join hold the processor up: assumed, dearer than on either port."""
RP2_ADC_PIN, RP2_CORE_TEMP = 26, 4
FLOATING_V = 0.4
_NS = 1_000_000_000
_FOREVER = float("inf")


def _ping(board: VirtualBoard, a: int, payload: bytes, t: float) -> None:
    board.answer(0, t)


def _i2c_init(board: VirtualBoard, a: int, payload: bytes, t: float) -> None:
    frequency, scl, sda = struct.unpack("<Ibb", payload)
    board.bus.initialise(frequency, scl, sda)
    board.answer(0, t)


def _i2c_read(board: VirtualBoard, a: int, payload: bytes, t: float) -> None:
    address, size, register, n = struct.unpack("<BBHH", payload)
    status, data, end = board.bus.read_mem(t * 1e-9, address, register.to_bytes(size, "big"), n)
    board.answer(status, end * _NS, data)


def _i2c_write(board: VirtualBoard, a: int, payload: bytes, t: float) -> None:
    address, size, register = struct.unpack_from("<BBH", payload)
    status, end = board.bus.write(t * 1e-9, address, register.to_bytes(size, "big") + payload[4:])
    board.answer(status, end * _NS)


def _i2c_scan(board: VirtualBoard, a: int, payload: bytes, t: float) -> None:
    found, end = board.bus.scan(t * 1e-9)
    board.answer(len(found), end * _NS, found)


def _i2c_start(board: VirtualBoard, a: int, payload: bytes, t: float) -> None:
    board.answer(board.bus.start(t * 1e-9, payload[0], payload[2:]), t)


def _i2c_put(board: VirtualBoard, a: int, payload: bytes, t: float) -> None:
    board.bus.put(t * 1e-9, payload)
    board.answer(0, t)


def _i2c_take(board: VirtualBoard, a: int, payload: bytes, t: float) -> None:
    board.answer(board.bus.take(t * 1e-9), t)


def _pin_init(board: VirtualBoard, a: int, payload: bytes, t: float) -> None:
    mode, pull = struct.unpack("<bb", payload)
    board.pins.initialise(t * 1e-9, a, mode, pull)
    board.answer(0, t)


def _pin_set(board: VirtualBoard, a: int, payload: bytes, t: float) -> None:
    board.pins.set(t * 1e-9, a, payload[0])
    board.answer(0, t)


def _pin_get(board: VirtualBoard, a: int, payload: bytes, t: float) -> None:
    board.answer(board.pins.get(t * 1e-9, a), t)


def _adc(board: VirtualBoard, a: int, payload: bytes, t: float) -> None:
    model, settings = board.model, board.settings
    pin = a + RP2_ADC_PIN if model.platform == "rp2" and a < RP2_CORE_TEMP else a
    if a == RP2_CORE_TEMP and model.platform == "rp2":
        volts = 0.706 - 0.001721 * (25.0 - 27.0)
    elif pin != model.battery:
        volts = FLOATING_V
    elif model.radio and (board.station.active or not board.pins.drives_high(RADIO_SELECT_PIN)):
        # The radio's chip select also switches the divider: MicroPython's issue 10406 has the 608 counts.
        volts = 0.0306
    else:
        volts = settings.battery_mv / 1000 / model.factor
    board.answer(0, t, struct.pack("<H", max(0, min(65535, round(volts / 3.3 * 65535)))))


def _wdt(board: VirtualBoard, a: int, payload: bytes, t: float) -> None:
    if a:
        board.wdt_timeout = struct.unpack("<I", payload)[0] * 1e6
    if board.wdt_timeout:
        board.wdt_deadline = t + board.wdt_timeout
    board.answer(0, t)


def _reset(board: VirtualBoard, a: int, payload: bytes, t: float) -> None:
    board.reset("machine.reset")


def _restarted(board: VirtualBoard, a: int, payload: bytes, t: float) -> None:
    board.restarted("machine.reset" if a & 2 else "watchdog")
    board.answer(0, t)


def _meter(board: VirtualBoard, a: int, payload: bytes, t: float) -> None:
    board.meter = json.loads(payload)
    board.answer(0, t)


def _soft_reset(board: VirtualBoard, a: int, payload: bytes, t: float) -> None:
    board.kill()
    board.counts["soft_resets"] += 1
    if board.stepped:
        board.t += BOOT_NS
    board.boot(raw=bool(a))


def _write(board: VirtualBoard, a: int, payload: bytes, t: float) -> None:
    port = board.ports.setdefault(a, Port())
    if port.link is None:
        board.counts["console"] += len(payload)
        board.answer(len(payload), port.put_on_wire(t, b"", len(payload)))
        return
    sent = board.noise.apply(payload)
    if board.link_log is not None and payload:
        board.link_log.append((time.time_ns(), payload, sent, board.link.host_open))
    board.counts["bytes_out"] += len(payload)
    if port.byte_ns:
        board.answer(len(payload), port.put_on_wire(t, sent, len(payload)))
        return
    port.to_send += sent

    def finished(late: bool) -> bool:
        board.send_waiting(port)
        if len(port.to_send) > TX_FIFO:
            if not late:
                return False
            board.counts["bytes_dropped"] += len(port.to_send) - TX_FIFO
            board.counts["writes_timed_out"] += 1
            del port.to_send[TX_FIFO:]
        board.answer(len(payload), board.now())
        return True

    board.answer_later(WRITE_TIMEOUT_NS, finished)


def _read(board: VirtualBoard, a: int, payload: bytes, t: float) -> None:
    most, wait_ms = struct.unpack("<Ii", payload)
    port = board.ports.setdefault(a, Port())
    if wait_ms and board.link_port == a:
        board.watch_link()
        board.take_input()

    def finished(late: bool) -> bool:
        if not (port.received or late or board.interrupt_came or wait_ms == 0):
            return False
        n = min(most, len(port.received))
        board.answer(n, board.now(), bytes(port.received.popleft() for _ in range(n)))
        return True

    board.answer_later(_FOREVER if wait_ms < 0 else wait_ms * 1e6, finished)


def _count(board: VirtualBoard, a: int, payload: bytes, t: float) -> None:
    if a & 0x100:
        sock = board.sockets.get(a & 0xFF)
        ready = (
            bool(board.mail.get(a & 0xFF)) or sock is not None and bool(select.select([sock], [], [], 0)[0])
        )
        board.answer(int(ready), t)
        return
    port = board.ports.setdefault(a, Port())
    room = COUNT_ROOM if port.room(t) > 0 or board.model.platform == "esp32" else 0
    board.answer(min(len(port.received), COUNT_MASK) | room, t)


def _uart_init(board: VirtualBoard, a: int, payload: bytes, t: float) -> None:
    port = board.ports.setdefault(a, Port())
    baud, port.send_buffer, port.receive_buffer = struct.unpack("<IHH", payload)
    port.byte_ns = 10e9 / max(1, baud)
    board.answer(0, t)


def _wlan(board: VirtualBoard, a: int, payload: bytes, t: float) -> None:
    station, seconds = board.station, t / _NS
    status = 0
    if a < 2:
        station.activate(a == 1, seconds)
    elif a == 2:
        status = station.connect(seconds)
        t += JOIN_NS
    elif a == 3:
        station.disconnect()
    elif a == 4:
        status = station.status(seconds)
    elif a == 5:
        status = int(station.up(seconds))
    else:
        station.reconnects((a & 0xFF) - 1)
    board.answer(status, t)


def _udp_open(board: VirtualBoard, a: int, payload: bytes, t: float) -> None:
    handle = next(k for k in range(1, 256) if k not in board.sockets)
    board.sockets[handle] = sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setblocking(False)
    board.answer(handle, t)


def _udp_bind(board: VirtualBoard, a: int, payload: bytes, t: float) -> None:
    try:
        board.sockets[a].bind(("127.0.0.1", struct.unpack("<H", payload)[0]))
    except OSError:
        board.answer(-EINVAL, t)
        return
    board.answer(0, t)


def _udp_send(board: VirtualBoard, a: int, payload: bytes, t: float) -> None:
    host, (port,) = socket.inet_ntoa(payload[:4]), struct.unpack_from("<H", payload, 4)
    if not board.station.up(t / _NS):
        board.answer(-EHOSTUNREACH, t)
        return
    if (host, port) in (NAME_SERVER, MULTICAST):
        reply = board.station.air.reply(t / _NS, payload[6:])
        if reply is not None:
            board.mail.setdefault(a, []).append(((host, port), reply))
        board.answer(len(payload) - 6, t)
        return
    try:
        n = board.sockets[a].sendto(payload[6:], (host, port))
    except BlockingIOError:
        board.answer(-EAGAIN, t)
    except OSError:
        # A datagram to nobody is lost in the air, not refused.
        board.counts["udp_lost"] += 1
        board.answer(len(payload) - 6, t)
    else:
        board.counts["bytes_out"] += n
        board.answer(n, t)


def _udp_recv(board: VirtualBoard, a: int, payload: bytes, t: float) -> None:
    most, wait_ms = struct.unpack("<Ii", payload)
    sock = board.sockets[a]

    def finished(late: bool) -> bool:
        try:
            if board.mail.get(a):
                (host, port), data = board.mail[a].pop(0)
            else:
                data, (host, port) = sock.recvfrom(most)
        except (BlockingIOError, ConnectionError):
            if not (late or wait_ms == 0):
                return False
            board.answer(-EAGAIN if wait_ms == 0 else -ETIMEDOUT, board.now())
            return True
        board.counts["bytes_in"] += len(data)
        board.answer(len(data), board.now(), socket.inet_aton(host) + struct.pack("<H", port) + data)
        return True

    board.answer_later(_FOREVER if wait_ms < 0 else wait_ms * 1e6, finished)


def _udp_close(board: VirtualBoard, a: int, payload: bytes, t: float) -> None:
    board.mail.pop(a, None)
    if a in board.sockets:
        board.sockets.pop(a).close()
    board.answer(0, t)


def _idle(board: VirtualBoard, a: int, payload: bytes, t: float) -> None:
    board.counts["at_prompt"] += 1
    board.answer(0, t)


HANDLERS: dict[int, Callable[[VirtualBoard, int, bytes, float], None]] = {
    Op.PING: _ping,
    Op.I2C_INIT: _i2c_init,
    Op.I2C_READ_MEM: _i2c_read,
    Op.I2C_WRITE_MEM: _i2c_write,
    Op.I2C_READ: _i2c_read,
    Op.I2C_WRITE: _i2c_write,
    Op.I2C_SCAN: _i2c_scan,
    Op.PIN_INIT: _pin_init,
    Op.PIN_SET: _pin_set,
    Op.PIN_GET: _pin_get,
    Op.ADC_READ: _adc,
    Op.WDT: _wdt,
    Op.RESET: _reset,
    Op.SOFT_RESET: _soft_reset,
    Op.WRITE: _write,
    Op.READ: _read,
    Op.COUNT: _count,
    Op.UART_INIT: _uart_init,
    Op.WLAN: _wlan,
    Op.UDP_OPEN: _udp_open,
    Op.UDP_BIND: _udp_bind,
    Op.UDP_SEND: _udp_send,
    Op.UDP_RECV: _udp_recv,
    Op.UDP_CLOSE: _udp_close,
    Op.IDLE: _idle,
    Op.RESTARTED: _restarted,
    Op.I2C_START: _i2c_start,
    Op.I2C_PUT: _i2c_put,
    Op.I2C_TAKE: _i2c_take,
    Op.METER: _meter,
}
