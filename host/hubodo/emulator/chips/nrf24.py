"""Emulated nRF24L01+: registers, FIFOs of three packets, and Enhanced ShockBurst with ACK payloads.

After the product specification 1.0: sections 6 (timing), 7 (packets, PID, ACK payloads), 8 (commands) and 9
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
_RESET_VALUES = {
    CONFIG: 8,
    EN_AA: 0x3F,
    EN_RXADDR: 3,
    SETUP_AW: 3,
    SETUP_RETR: 3,
    RF_CH: 2,
    RF_SETUP: 0x0E,
    RPD: 1,
}
_WRITABLE_BITS = {
    CONFIG: 0x7F,
    EN_AA: 0x3F,
    EN_RXADDR: 0x3F,
    SETUP_AW: 3,
    SETUP_RETR: 0xFF,
    RF_CH: 0x7F,
    RF_SETUP: 0xBE,
    DYNPD: 0x3F,
    FEATURE: 7,
    **{0x11 + pipe: 0x3F for pipe in range(6)},
}
_FIFO_DEPTH, _PIPES, _MAX_PAYLOAD_BYTES = 3, 6, 32
_POWER_UP_NS, _PLL_SETTLE_NS = 1.5e6, 130e3
_OVERHEAD_BYTES = 1 + 5 + 2
DUPLICATE_DELAY_NS, LATE_DELAY_NS = 2e6, 5e6
"""Delays of a duplicate and of a delayed packet."""


@dataclass(frozen=True)
class PacketFaults:
    """Probabilities of faults of a packet on the air; acknowledgements are packets.

    Attributes
    ----------
    loss : the packet is lost.
    duplication : the packet is received again after `DUPLICATE_DELAY_NS`.
    delay : the packet is received late, by `LATE_DELAY_NS`, behind others.
    """

    loss: float = 0.0
    duplication: float = 0.0
    delay: float = 0.0


class PacketMedium(Protocol):
    """Part of `board.radio_medium.RadioMedium` that an nRF24L01+ uses."""

    packet_faults: PacketFaults
    random: random.Random
    radios: list[Nrf24]

    def schedule(self, t: float, event: Callable[[float], None]) -> None: ...

    def draw_loss(self, kind: str) -> bool: ...


class RadioAccessError(HubodoError):
    """A driver used an undocumented command or register."""


@dataclass
class _Packet:
    """A packet on the air; times in ns. wants_ack: it requests an acknowledgement."""

    sender: Nrf24
    address: bytes
    pid: int
    payload: bytes
    wants_ack: bool
    start_ns: float
    end_ns: float
    collided: bool = False


@dataclass
class _Pipe:
    """State of a data pipe: the newest packet, and the payloads of acknowledgements."""

    last_packet: tuple[int, bytes] | None = None
    ack_payload: bytes | None = None
    """Payload of the last acknowledgement, repeated with each retry of its packet."""
    queued_acks: list[bytes] = field(default_factory=list)


class Nrf24:
    """One chip with its pins `select` (CSN), `transfer` (SPI) and `enable` (CE); times are in ns."""

    def __init__(self, medium: PacketMedium) -> None:
        self._medium = medium
        self.values = bytearray(0x20)
        for register, value in _RESET_VALUES.items():
            self.values[register] = value
        self._addresses = {RX_ADDR_P0: b"\xe7" * 5, RX_ADDR_P0 + 1: b"\xc2" * 5, TX_ADDR: b"\xe7" * 5}
        self._low_addresses = {RX_ADDR_P0 + pipe: 0xC1 + pipe for pipe in range(2, _PIPES)}
        self.tx: list[tuple[bytes, bool]] = []
        self.rx: list[tuple[int, bytes]] = []
        self._pipes = [_Pipe() for _ in range(_PIPES)]
        self._flags = self._pid = self._retries = self._lost_packets = 0
        self._enabled = self._selected = self._resend = self.switched_off = False
        self._powered_at = self._listening_at = 0.0
        self._on_air: _Packet | None = None
        self._received = b""
        medium.radios.append(self)

    def select(self, t: float, *, selected: bool) -> None:
        """Set CSN: a command begins, or ends and is executed."""
        if self._selected and not selected and self._received:
            self._execute(t, self._received[0], self._received[1:])
        self._selected, self._received = selected, b""

    def transfer(self, t: float, data: bytes) -> bytes:
        """Exchange bytes on SPI; return the status byte and then the data of the command."""
        offset, self._received = len(self._received), self._received + data
        if not self._selected:
            return bytes(len(data))
        ack_payload = bytes([self._status_register()]) + self._read_command(t, self._received[0])
        return (ack_payload + bytes(len(self._received)))[offset : offset + len(data)]

    def enable(self, t: float, *, on: bool) -> None:
        """Set CE."""
        if on and not self._enabled:
            self._listening_at = max(t, self._powered_at) + _PLL_SETTLE_NS
        self._enabled = on
        self._send_next(t)

    def _status_register(self) -> int:
        """Return the STATUS register."""
        pipe = self.rx[0][0] if self.rx else 7
        return self._flags | pipe << 1 | (self._queued_count() >= _FIFO_DEPTH)

    def _queued_count(self) -> int:
        """Return the number of queued payloads."""
        return len(self.tx) + sum(len(pipe.queued_acks) for pipe in self._pipes)

    def _read_command(self, t: float, command: int) -> bytes:
        """Return the data bytes of a read command."""
        if command < 0x20:
            return self._read_register(command)
        if command == 0x60:
            return bytes([len(self.rx[0][1]) if self.rx else 0])
        if command == 0x61:
            return self.rx[0][1] if self.rx else b""
        return b""

    def _read_register(self, register: int) -> bytes:
        """Return the bytes of a register."""
        if register in self._addresses:
            return self._addresses[register]
        if register in self._low_addresses:
            return bytes([self._low_addresses[register]])
        if register == STATUS:
            return bytes([self._status_register()])
        if register == OBSERVE_TX:
            return bytes([min(self._lost_packets, 15) << 4 | self._retries])
        if register == FIFO_STATUS:
            return bytes(
                [
                    (self._queued_count() >= 3) << 5
                    | (not self.tx) << 4
                    | (len(self.rx) >= 3) << 1
                    | (not self.rx)
                ]
            )
        return bytes([self.values[register]])

    def _execute(self, t: float, command: int, data: bytes) -> None:
        """Execute a command that is complete."""
        if 0x20 <= command < 0x40:
            self._write_register(t, command - 0x20, data)
        elif command == 0x61:
            self.rx[:1] = []
        elif command in (0xA0, 0xB0):
            self._queue(data, wants_ack=command == 0xA0 or not self.values[FEATURE] & 1)
        elif 0xA8 <= command < 0xA8 + _PIPES:
            if self._queued_count() < _FIFO_DEPTH:
                self._pipes[command - 0xA8].queued_acks.append(data[:_MAX_PAYLOAD_BYTES])
        elif command == 0xE1:
            self.tx.clear()
            for pipe in self._pipes:
                pipe.queued_acks.clear()
        elif command == 0xE2:
            self.rx.clear()
        elif command not in (0x60, 0xFF) and command >= 0x20:
            raise RadioAccessError(f"nRF24L01+: command 0x{command:02X} is not modelled; correct the driver")
        self._send_next(t)

    def _queue(self, data: bytes, *, wants_ack: bool) -> None:
        """Queue a payload for sending; wants_ack: True to request an acknowledgement."""
        if len(self.tx) < _FIFO_DEPTH and data:
            self.tx.append((data[:_MAX_PAYLOAD_BYTES], wants_ack))

    def _write_register(self, t: float, register: int, data: bytes) -> None:
        """Write a register."""
        if register in self._addresses:
            self._addresses[register] = data
        elif register in self._low_addresses:
            self._low_addresses[register] = data[0]
        elif register == STATUS:
            self._flags &= ~data[0] & 0x70
        elif register in _WRITABLE_BITS:
            old = self.values[register]
            self.values[register] = data[0] & _WRITABLE_BITS[register]
            if register == CONFIG and not old & 2 and data[0] & 2:
                self._powered_at = t + _POWER_UP_NS
        else:
            raise RadioAccessError(f"nRF24L01+: write of register 0x{register:02X}; correct the driver")

    @property
    def _rate(self) -> float:
        """Air data rate, bit/s."""
        setup = self.values[RF_SETUP]
        return 250e3 if setup & 0x20 else 2e6 if setup & 8 else 1e6

    def _airtime(self, payload: bytes) -> float:
        """Return the duration of a packet on the air, ns."""
        return ((_OVERHEAD_BYTES + len(payload)) * 8 + 9) / self._rate * 1e9

    def _send_next(self, t: float) -> None:
        """Send the first queued packet if the mode allows it."""
        may_send = self.values[CONFIG] & 3 == 2 and self._enabled and not self._flags & MAX_RT
        if may_send and self.tx and self._on_air is None:
            if not self._resend:
                self._pid = self._pid + 1 & 3
            self._resend, self._retries = False, 0
            self._send(max(t, self._powered_at))

    def _send(self, t: float) -> None:
        """Put the first queued packet on the air, and detect collisions."""
        start_ns = t + _PLL_SETTLE_NS
        payload, wants_ack = self.tx[0]
        end_ns = start_ns + self._airtime(payload)
        packet = _Packet(self, self._addresses[TX_ADDR], self._pid, payload, wants_ack, start_ns, end_ns)
        self._on_air = packet
        for other in self._other_radios():
            their_packet = other._on_air
            if (
                their_packet is not None
                and their_packet.start_ns < packet.end_ns
                and packet.start_ns < their_packet.end_ns
            ):
                their_packet.collided = packet.collided = True
        self._medium.schedule(packet.end_ns, lambda now: self._end_packet(packet, now))

    def _other_radios(self) -> list[Nrf24]:
        """Return the other radios on this channel."""
        mine = self.values[RF_CH]
        return [radio for radio in self._medium.radios if radio is not self and radio.values[RF_CH] == mine]

    def _end_packet(self, packet: _Packet, t: float) -> None:
        """Deliver a packet to the other radios at its end, and schedule the retry."""
        lost = self._medium.draw_loss("packets") or packet.collided
        for other in self._other_radios():
            if not lost and not self.switched_off:
                other._receive_packet(packet, t)
        if not packet.wants_ack:
            self._complete_packet(t)
            return
        delay = ((self.values[SETUP_RETR] >> 4) + 1) * 250e3
        self._medium.schedule(t + delay, lambda now: self._check_ack(packet, now))

    def _check_ack(self, packet: _Packet, t: float) -> None:
        """Retry a packet without acknowledgement, or give it up."""
        if packet is not self._on_air or self.switched_off:
            return
        self._on_air = None
        if self._retries < self.values[SETUP_RETR] & 0xF:
            self._retries += 1
            self._send(t - _PLL_SETTLE_NS)
        else:
            # A later retry keeps its PID: for the receiver it is the same packet.
            self._resend = True
            self._flags |= MAX_RT
            self._lost_packets += 1

    def _receive_packet(self, packet: _Packet, t: float) -> None:
        """Receive a packet and acknowledge it."""
        is_listening = self.values[CONFIG] & 3 == 3 and self._enabled and t >= self._listening_at
        number = self._pipe_of(packet.address)
        if not is_listening or number is None or self.switched_off:
            return
        pipe, identity = self._pipes[number], (packet.pid, packet.payload)
        if pipe.last_packet != identity:
            if len(self.rx) >= _FIFO_DEPTH:
                return
            pipe.last_packet = identity
            pipe.ack_payload = pipe.queued_acks.pop(0) if pipe.queued_acks else None
            self._flags |= TX_DS if pipe.ack_payload else 0
            self._receive_payload(number, packet.payload, t)
        if not packet.wants_ack:
            return
        ack_payload = pipe.ack_payload or b""
        arrives = t + _PLL_SETTLE_NS + self._airtime(ack_payload)
        self._medium.schedule(arrives, lambda now: packet.sender._receive_ack(packet, ack_payload, now))

    def _receive_payload(self, pipe: int, payload: bytes, t: float) -> None:
        """Store a received payload, with the faults of the medium."""
        packet_faults, draw_random = self._medium.packet_faults, self._medium.random.random
        if draw_random() < packet_faults.delay:
            self._store_later(pipe, payload, t + LATE_DELAY_NS)
            return
        self._store(pipe, payload)
        if draw_random() < packet_faults.duplication:
            self._store_later(pipe, payload, t + DUPLICATE_DELAY_NS)

    def _store_later(self, pipe: int, payload: bytes, t: float) -> None:
        """Schedule the reception of a payload at t."""

        def now(t: float) -> None:
            if not self._store(pipe, payload):
                self._store_later(pipe, payload, t + DUPLICATE_DELAY_NS)

        self._medium.schedule(t, now)

    def _store(self, pipe: int, payload: bytes) -> bool:
        """Store a payload in the RX FIFO; return False if it is full."""
        if len(self.rx) >= _FIFO_DEPTH:
            return False
        self.rx.append((pipe, payload))
        self._flags |= RX_DR
        return True

    def _receive_ack(self, packet: _Packet, payload: bytes, t: float) -> None:
        """Receive the acknowledgement of a packet, with its payload."""
        if packet is not self._on_air or self.switched_off or self._medium.draw_loss("answers"):
            return
        if payload:
            self._store(0, payload)
        self._complete_packet(t)

    def _complete_packet(self, t: float) -> None:
        """Complete the packet that was sent, and send the next one."""
        self._on_air = None
        self.tx[:1] = []
        self._flags |= TX_DS
        self._send_next(t)

    def _pipe_of(self, address: bytes) -> int | None:
        """Return the number of the enabled pipe with this address, or None."""
        for number in range(_PIPES):
            if self.values[EN_RXADDR] >> number & 1:
                own = self._addresses.get(RX_ADDR_P0 + number)
                if own is None:
                    own = (
                        bytes([self._low_addresses[RX_ADDR_P0 + number]])
                        + self._addresses[RX_ADDR_P0 + 1][1:]
                    )
                if own == address:
                    return number
        return None
