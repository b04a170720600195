"""nRF24L01+: registers, FIFOs of three, and Enhanced ShockBurst with acknowledgements that carry payloads.

After the product specification 1.0: sections 6 (timing), 7 (packets, PID, ACK payloads), 8 (commands), 9
(registers). Not modelled: static payload widths, more than one address width, RPD by distance (always set).
"""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from hubodo.errors import HubodoError

CONFIG, EN_AA, EN_RXADDR, SETUP_AW, SETUP_RETR, RF_CH, RF_SETUP, STATUS, OBSERVE_TX, RPD = range(10)
RX_ADDR_P0, TX_ADDR, FIFO_STATUS, DYNPD, FEATURE = 0x0A, 0x10, 0x17, 0x1C, 0x1D
RX_DR, TX_DS, MAX_RT = 0x40, 0x20, 0x10
_RESET = {CONFIG: 8, EN_AA: 0x3F, EN_RXADDR: 3, SETUP_AW: 3, SETUP_RETR: 3, RF_CH: 2, RF_SETUP: 0x0E, RPD: 1}
_WRITABLE = {CONFIG: 0x7F, EN_AA: 0x3F, EN_RXADDR: 0x3F, SETUP_AW: 3, SETUP_RETR: 0xFF, RF_CH: 0x7F}
_WRITABLE |= {RF_SETUP: 0xBE, DYNPD: 0x3F, FEATURE: 7, **{0x11 + pipe: 0x3F for pipe in range(6)}}
_DEPTH, _PIPES, _MOST = 3, 6, 32
_POWER_UP_NS, _SETTLE_NS = 1.5e6, 130e3
_WIRE = 1 + 5 + 2
TWICE_NS, LATE_NS = 2e6, 5e6
"""See `Weather`."""


@dataclass(frozen=True)
class Weather:
    """What the air does to packets, each by its probability; acknowledgements are packets.

    twice: heard again two milliseconds later, as a packet of its own. late: heard five milliseconds later,
    behind others.
    """

    lose: float = 0.0
    twice: float = 0.0
    late: float = 0.0


class SharedAir(Protocol):
    """See `board.ether.Ether`."""

    weather: Weather
    random: random.Random
    radios: list[Nrf24]

    def later(self, t: float, what: Callable[[float], None]) -> None: ...

    def lost(self, kind: str) -> bool: ...


class RadioAccessError(HubodoError):
    """A driver used a command or register that the specification does not give."""


@dataclass
class _Packet:
    sender: Nrf24
    address: bytes
    pid: int
    payload: bytes
    asks: bool
    begin: float
    end: float
    spoilt: bool = False


@dataclass
class _Pipe:
    newest: tuple[int, bytes] | None = None
    answer: bytes | None = None
    """The payload of the last acknowledgement: it goes with each repeat of the packet that it answers."""
    queued: list[bytes] = field(default_factory=list)


class Nrf24:
    """One chip; `select`, `transfer` and `enable` are its pins, times in ns."""

    def __init__(self, air: SharedAir) -> None:
        self._air = air
        self.values = bytearray(0x20)
        for register, value in _RESET.items():
            self.values[register] = value
        self._addresses = {RX_ADDR_P0: b"\xe7" * 5, RX_ADDR_P0 + 1: b"\xc2" * 5, TX_ADDR: b"\xe7" * 5}
        self._low = {RX_ADDR_P0 + pipe: 0xC1 + pipe for pipe in range(2, _PIPES)}
        self.tx: list[tuple[bytes, bool]] = []
        self.rx: list[tuple[int, bytes]] = []
        self._pipes = [_Pipe() for _ in range(_PIPES)]
        self._flags = self._pid = self._tries = self._lost = 0
        self._on = self._selected = self._again = self.silent = False
        self._up_at = self._listens_at = 0.0
        self._packet: _Packet | None = None
        self._sent = b""
        air.radios.append(self)

    # ---- pins ----

    def select(self, t: float, *, selected: bool) -> None:
        """CSN: a command begins, or is over and done."""
        if self._selected and not selected and self._sent:
            self._do(t, self._sent[0], self._sent[1:])
        self._selected, self._sent = selected, b""

    def transfer(self, t: float, data: bytes) -> bytes:
        """Bytes on MOSI; those on MISO: the status first, then what the command reads."""
        begun, self._sent = len(self._sent), self._sent + data
        if not self._selected:
            return bytes(len(data))
        answer = bytes([self._status()]) + self._read(t, self._sent[0])
        return (answer + bytes(len(self._sent)))[begun : begun + len(data)]

    def enable(self, t: float, *, on: bool) -> None:
        """CE."""
        if on and not self._on:
            self._listens_at = max(t, self._up_at) + _SETTLE_NS
        self._on = on
        self._begin(t)

    # ---- commands ----

    def _status(self) -> int:
        pipe = self.rx[0][0] if self.rx else 7
        return self._flags | pipe << 1 | (self._waiting() >= _DEPTH)

    def _waiting(self) -> int:
        return len(self.tx) + sum(len(pipe.queued) for pipe in self._pipes)

    def _read(self, t: float, command: int) -> bytes:
        if command < 0x20:
            return self._register(command)
        if command == 0x60:
            return bytes([len(self.rx[0][1]) if self.rx else 0])
        if command == 0x61:
            return self.rx[0][1] if self.rx else b""
        return b""

    def _register(self, register: int) -> bytes:
        if register in self._addresses:
            return self._addresses[register]
        if register in self._low:
            return bytes([self._low[register]])
        if register == STATUS:
            return bytes([self._status()])
        if register == OBSERVE_TX:
            return bytes([min(self._lost, 15) << 4 | self._tries])
        if register == FIFO_STATUS:
            return bytes(
                [(self._waiting() >= 3) << 5 | (not self.tx) << 4 | (len(self.rx) >= 3) << 1 | (not self.rx)]
            )
        return bytes([self.values[register]])

    def _do(self, t: float, command: int, data: bytes) -> None:
        if 0x20 <= command < 0x40:
            self._write(t, command - 0x20, data)
        elif command == 0x61:
            self.rx[:1] = []
        elif command in (0xA0, 0xB0):
            self._queue(data, asks=command == 0xA0 or not self.values[FEATURE] & 1)
        elif 0xA8 <= command < 0xA8 + _PIPES:
            if self._waiting() < _DEPTH:
                self._pipes[command - 0xA8].queued.append(data[:_MOST])
        elif command == 0xE1:
            self.tx.clear()
            for pipe in self._pipes:
                pipe.queued.clear()
        elif command == 0xE2:
            self.rx.clear()
        elif command not in (0x60, 0xFF) and command >= 0x20:
            raise RadioAccessError(f"nRF24L01+: command 0x{command:02X} is not modelled; correct the driver")
        self._begin(t)

    def _queue(self, data: bytes, *, asks: bool) -> None:
        """asks: for an acknowledgement."""
        if len(self.tx) < _DEPTH and data:
            self.tx.append((data[:_MOST], asks))

    def _write(self, t: float, register: int, data: bytes) -> None:
        if register in self._addresses:
            self._addresses[register] = data
        elif register in self._low:
            self._low[register] = data[0]
        elif register == STATUS:
            self._flags &= ~data[0] & 0x70
        elif register in _WRITABLE:
            was = self.values[register]
            self.values[register] = data[0] & _WRITABLE[register]
            if register == CONFIG and not was & 2 and data[0] & 2:
                self._up_at = t + _POWER_UP_NS
        else:
            raise RadioAccessError(f"nRF24L01+: write of register 0x{register:02X}; correct the driver")

    # ---- on the air ----

    @property
    def _rate(self) -> float:
        setup = self.values[RF_SETUP]
        return 250e3 if setup & 0x20 else 2e6 if setup & 8 else 1e6

    def _airtime(self, payload: bytes) -> float:
        return ((_WIRE + len(payload)) * 8 + 9) / self._rate * 1e9

    def _begin(self, t: float) -> None:
        """Sends the first that waits, if it may."""
        sends = self.values[CONFIG] & 3 == 2 and self._on and not self._flags & MAX_RT
        if sends and self.tx and self._packet is None:
            if not self._again:
                self._pid = self._pid + 1 & 3
            self._again, self._tries = False, 0
            self._send(max(t, self._up_at))

    def _send(self, t: float) -> None:
        begin = t + _SETTLE_NS
        payload, asks = self.tx[0]
        end = begin + self._airtime(payload)
        packet = _Packet(self, self._addresses[TX_ADDR], self._pid, payload, asks, begin, end)
        self._packet = packet
        for other in self._others():
            theirs = other._packet
            if theirs is not None and theirs.begin < packet.end and packet.begin < theirs.end:
                theirs.spoilt = packet.spoilt = True
        self._air.later(packet.end, lambda now: self._over(packet, now))

    def _others(self) -> list[Nrf24]:
        mine = self.values[RF_CH]
        return [radio for radio in self._air.radios if radio is not self and radio.values[RF_CH] == mine]

    def _over(self, packet: _Packet, t: float) -> None:
        lost = self._air.lost("packets") or packet.spoilt
        for other in self._others():
            if not lost and not self.silent:
                other._hear(packet, t)
        if not packet.asks:
            self._done(t)
            return
        delay = ((self.values[SETUP_RETR] >> 4) + 1) * 250e3
        self._air.later(t + delay, lambda now: self._unanswered(packet, now))

    def _unanswered(self, packet: _Packet, t: float) -> None:
        if packet is not self._packet or self.silent:
            return
        self._packet = None
        if self._tries < self.values[SETUP_RETR] & 0xF:
            self._tries += 1
            self._send(t - _SETTLE_NS)
        else:
            # What is tried again after that is the same packet to a receiver.
            self._again = True
            self._flags |= MAX_RT
            self._lost += 1

    def _hear(self, packet: _Packet, t: float) -> None:
        listens = self.values[CONFIG] & 3 == 3 and self._on and t >= self._listens_at
        number = self._pipe_of(packet.address)
        if not listens or number is None or self.silent:
            return
        pipe, rest = self._pipes[number], (packet.pid, packet.payload)
        if pipe.newest != rest:
            if len(self.rx) >= _DEPTH:
                return
            pipe.newest = rest
            pipe.answer = pipe.queued.pop(0) if pipe.queued else None
            self._flags |= TX_DS if pipe.answer else 0
            self._take(number, packet.payload, t)
        if not packet.asks:
            return
        answer = pipe.answer or b""
        arrives = t + _SETTLE_NS + self._airtime(answer)
        self._air.later(arrives, lambda now: packet.sender._answered(packet, answer, now))

    def _take(self, pipe: int, payload: bytes, t: float) -> None:
        weather, draw = self._air.weather, self._air.random.random
        if draw() < weather.late:
            self._store_later(pipe, payload, t + LATE_NS)
            return
        self._store(pipe, payload)
        if draw() < weather.twice:
            self._store_later(pipe, payload, t + TWICE_NS)

    def _store_later(self, pipe: int, payload: bytes, t: float) -> None:
        def now(t: float) -> None:
            if not self._store(pipe, payload):
                self._store_later(pipe, payload, t + TWICE_NS)

        self._air.later(t, now)

    def _store(self, pipe: int, payload: bytes) -> bool:
        if len(self.rx) >= _DEPTH:
            return False
        self.rx.append((pipe, payload))
        self._flags |= RX_DR
        return True

    def _answered(self, packet: _Packet, payload: bytes, t: float) -> None:
        if packet is not self._packet or self.silent or self._air.lost("answers"):
            return
        if payload:
            self._store(0, payload)
        self._done(t)

    def _done(self, t: float) -> None:
        """The packet is sent: the next one, if it waits."""
        self._packet = None
        self.tx[:1] = []
        self._flags |= TX_DS
        self._begin(t)

    def _pipe_of(self, address: bytes) -> int | None:
        for number in range(_PIPES):
            if self.values[EN_RXADDR] >> number & 1:
                own = self._addresses.get(RX_ADDR_P0 + number)
                if own is None:
                    own = bytes([self._low[RX_ADDR_P0 + number]]) + self._addresses[RX_ADDR_P0 + 1][1:]
                if own == address:
                    return number
        return None
