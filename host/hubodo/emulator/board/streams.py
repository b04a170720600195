"""The processor's byte streams at a call: standard streams and UARTs, one of which is the link to a host."""

from __future__ import annotations

import select
import struct
import time
from collections import Counter
from collections.abc import Callable

from hubodo.emulator.board.byte_stream import ByteStream
from hubodo.emulator.board.clock import FOREVER, BoardClock
from hubodo.emulator.board.hypercall import (
    COUNT_MASK,
    COUNT_ROOM,
    FLAG_INPUT,
    FLAG_INTERRUPT,
    FLAG_OPEN,
    FLAG_PLUGGED,
    FLAG_ROOM,
    Deferred,
    Handler,
    Op,
    Reply,
)
from hubodo.emulator.board.link import TX_FIFO, HostLink, LineNoise, MemoryLink, PtyLink
from hubodo.emulator.board.models import BoardModel
from hubodo.emulator.board.settings import BoardSettings
from hubodo.units import NS_PER_S

CTRL_C = 3
WRITE_TIMEOUT_NS = 500_000_000
BUSY_NS = 2_000_000_000
CONSOLE_BYTE_NS, CONSOLE_FIFO = 10e9 / 115200, 128
_LOOK_S = 0.005


class Streams:
    """Of one board.

    poll: where the link's terminal is waited for while a host has it open. counts: the board's. waits:
    whether a datagram waits for the socket with a handle.
    """

    def __init__(
        self,
        settings: BoardSettings,
        model: BoardModel,
        link: HostLink,
        noise: LineNoise,
        clock: BoardClock,
        poll: select.poll,
        counts: Counter[str],
        waits: Callable[[int], bool],
    ) -> None:
        self.link, self.noise = link, noise
        self.log: list[tuple[int, bytes, bytes, bool]] | None = None
        """(host ns, bytes written, after noise, host was listening), where a list is put here."""
        self.interrupt_came = False
        self.watched = -1
        """Descriptor of the terminal while it is waited for."""
        self._clock, self._poll, self._counts, self._waits = clock, poll, counts, waits
        self._takes_all = model.platform == "esp32"
        self._emulated = settings.emulated
        self._interrupt_at = 0
        self._looked = 0.0
        self._on_uart = settings.uart_link is not None
        self._link_port = 0 if settings.uart_link is None else settings.uart_link + 1
        self._ports: dict[int, ByteStream] = {0: ByteStream()}
        self._ports[self._link_port] = ByteStream(link=link)
        if self._takes_all:
            self._ports[0].byte_ns, self._ports[0].send_buffer = CONSOLE_BYTE_NS, CONSOLE_FIFO
        self.begin()

    def begin(self) -> None:
        """An interpreter begins. In an emulated processor MicroPython itself looks for ctrl-C."""
        self._interrupt_char = -1 if self._emulated else CTRL_C

    def reset(self) -> None:
        """The processor restarts: what waits is lost."""
        for port in self._ports.values():
            port.clear()
        self.interrupt_came = False

    def forget_link(self) -> None:
        """The processor has restarted by itself: what waits on the link is lost."""
        self._ports[self._link_port].clear()

    def handlers(self) -> dict[int, Handler]:
        """What each call does here."""
        return {Op.WRITE: self._write, Op.READ: self._read, Op.COUNT: self._count, Op.UART_INIT: self._uart}

    # ---- the link ----

    def unplug(self) -> bool:
        """Pulls the cable; False where there is none."""
        if not isinstance(self.link, PtyLink):
            return False
        self.forget_terminal()
        self.link.unplug()
        self._ports[self._link_port].to_send.clear()
        self._counts["unplugged"] += 1
        return True

    def plug(self) -> None:
        """Puts the cable back; the terminal has a new name."""
        if isinstance(self.link, PtyLink):
            self.link.plug()

    @property
    def usb(self) -> bool:
        """Whether the link is USB, which goes away with the processor."""
        return isinstance(self.link, PtyLink) and not self._on_uart

    def forget_terminal(self) -> None:
        """Waits for the terminal no more."""
        if self.watched >= 0:
            self._poll.unregister(self.watched)
            self.watched = -1

    def watch(self) -> None:
        """Waits for the terminal while a host has it open and may say something."""
        if self._full or not self.link.host_open:
            self.forget_terminal()
            return
        fd = self.link.fileno()
        if fd != self.watched:
            self.forget_terminal()
            self._poll.register(fd, select.POLLIN)
            self.watched = fd

    def happened(self, event: int) -> None:
        """The terminal that is waited for has input, or its host has gone."""
        if event & select.POLLIN:
            self.take_input()
        if event & (select.POLLHUP | select.POLLERR):
            self.watch()

    def watch_now_and_then(self) -> None:
        """Sees whether a host has come or gone, every few ms."""
        now = time.monotonic()
        if now - self._looked > _LOOK_S:
            self._looked = now
            self.watch()
            self.take_script()

    def take_script(self) -> None:
        """Takes what a scripted host has said by now."""
        if isinstance(self.link, MemoryLink):
            self.take_input()

    def take_input(self) -> None:
        """Takes what the host has sent since."""
        if isinstance(self.link, MemoryLink):
            self.link.t = self._clock.now() * 1e-9
        port = self._ports[self._link_port]
        if self._full:
            self.forget_terminal()
            return
        data = self.link.read()
        if not data:
            return
        self._counts["bytes_in"] += len(data)
        if self._link_port == 0 and self._interrupt_char >= 0 and self._interrupt_char in data:
            self._interrupted()
            data = data[data.rindex(self._interrupt_char) + 1 :]
        if self._on_uart:
            room = port.receive_buffer - len(port.received)
            self._counts["bytes_in_dropped"] += max(0, len(data) - room)
            data = data[:room]
        port.received += data

    @property
    def _full(self) -> bool:
        """Whether the host has to wait: USB takes no more bytes than the device has room for; a UART does."""
        port = self._ports[self._link_port]
        room = 1 if self._emulated else port.receive_buffer
        return (self._emulated or not self._on_uart) and len(port.received) >= room

    def send_waiting(self) -> None:
        """Sends as much of what waits for the host as goes."""
        self._send(self._ports[self._link_port])

    def _send(self, port: ByteStream) -> None:
        while port.on_wire and port.on_wire[0][0] <= self._clock.now():
            port.to_send += port.on_wire.popleft()[1]
        if port.to_send and port.link is not None:
            n = port.link.write(bytes(port.to_send))
            del port.to_send[:n]

    @property
    def sending(self) -> bool:
        """Whether bytes wait for the host."""
        return bool(self._ports[self._link_port].to_send)

    @property
    def due(self) -> float:
        """ns at which a UART's next bytes are over."""
        port = self._ports[self._link_port]
        return port.on_wire[0][0] if port.on_wire else FOREVER

    @property
    def quiet(self) -> float:
        """ns up to which the host says and takes nothing: known of a script alone; 0 where it is not."""
        port = self._ports[self._link_port]
        if not isinstance(self.link, MemoryLink) or port.to_send or port.on_wire:
            return 0.0
        return self.link.next_word * NS_PER_S

    # ---- ctrl-C ----

    def heed(self, interrupt_char: int) -> None:
        """The interpreter says which byte interrupts it (-1: none)."""
        before, received = self._interrupt_char, self._ports[0].received
        if interrupt_char == before:
            return
        self._interrupt_char = interrupt_char
        # What came after the code that wants it so had begun, before this call could say so.
        if interrupt_char >= 0 and interrupt_char in received:
            self._interrupted()
        elif interrupt_char < 0 and self.interrupt_came:
            self.interrupt_came = False
            received[:0] = bytes([before])

    def _interrupted(self) -> None:
        """The interrupt character came in: what waits before it is forgotten, as the ports do."""
        self._ports[0].received.clear()
        if not self.interrupt_came:
            self._interrupt_at = time.monotonic_ns()
        self.interrupt_came = True

    def interrupt_unheard(self) -> bool:
        """Whether ctrl-C came seconds ago and nobody has asked since."""
        return self.interrupt_came and time.monotonic_ns() - self._interrupt_at > BUSY_NS

    def say(self, words: bytes) -> None:
        """The board itself says something on standard output."""
        self._ports[0].to_send += words

    def flags(self) -> int:
        """What every answer tells; that ctrl-C came is told once."""
        port = self._ports[0]
        flags = 0
        if port.received:
            flags |= FLAG_INPUT
        if len(port.to_send) < TX_FIFO or self._takes_all:
            flags |= FLAG_ROOM
        if self.interrupt_came:
            flags |= FLAG_INTERRUPT
            self.interrupt_came = False
        if self.link.host_open:
            flags |= FLAG_OPEN
        if self.link.plugged:
            flags |= FLAG_PLUGGED
        return flags

    # ---- calls ----

    def _port(self, number: int) -> ByteStream:
        return self._ports.setdefault(number, ByteStream())

    def _write(self, a: int, payload: bytes, t: float) -> Reply | Deferred:
        port = self._port(a)
        if port.link is None:
            self._counts["console"] += len(payload)
            return Reply(port.put_on_wire(t, b"", len(payload)), len(payload))
        sent = self.noise.apply(payload)
        if self.log is not None and payload:
            self.log.append((time.time_ns(), payload, sent, self.link.host_open))
        self._counts["bytes_out"] += len(payload)
        if port.byte_ns:
            return Reply(port.put_on_wire(t, sent, len(payload)), len(payload))
        port.to_send += sent

        def finished(late: bool) -> Reply | None:
            self._send(port)
            if len(port.to_send) > TX_FIFO:
                if not late:
                    return None
                self._counts["bytes_dropped"] += len(port.to_send) - TX_FIFO
                self._counts["writes_timed_out"] += 1
                del port.to_send[TX_FIFO:]
            return Reply(self._clock.now(), len(payload))

        return Deferred(WRITE_TIMEOUT_NS, finished)

    def _read(self, a: int, payload: bytes, t: float) -> Deferred:
        most, wait_ms = struct.unpack("<Ii", payload)
        port = self._port(a)
        if wait_ms and self._link_port == a:
            self.watch()
            self.take_input()

        def finished(late: bool) -> Reply | None:
            if not (port.received or late or self.interrupt_came or wait_ms == 0):
                return None
            data = bytes(port.received[:most])
            del port.received[:most]
            return Reply(self._clock.now(), len(data), data)

        return Deferred(FOREVER if wait_ms < 0 else wait_ms * 1e6, finished)

    def _count(self, a: int, payload: bytes, t: float) -> Reply:
        if a & 0x100:
            return Reply(t, int(self._waits(a & 0xFF)))
        port = self._port(a)
        room = COUNT_ROOM if port.room(t) > 0 or self._takes_all else 0
        return Reply(t, min(len(port.received), COUNT_MASK) | room)

    def _uart(self, a: int, payload: bytes, t: float) -> Reply:
        port = self._port(a)
        baud, port.send_buffer, port.receive_buffer = struct.unpack("<IHH", payload)
        port.byte_ns = 10e9 / max(1, baud)
        return Reply(t)
