"""Byte streams of the processor: standard streams and UARTs, one of which is the link to the host."""

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
BUSY_LOOP_NS = 2_000_000_000
CONSOLE_BYTE_NS, CONSOLE_FIFO = 10e9 / 115200, 128
_HOST_POLL_S = 0.005


class BoardStreams:
    """Byte streams of one board.

    Parameters
    ----------
    settings, model : settings and model of the board.
    link, noise : link to the host, and noise on it.
    clock : clock of the board.
    poll : poll object on which the terminal of the link is registered while a host has it open.
    counts : counters of the board.
    waits : function of a socket handle that returns True if a datagram is available.
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
        """Record of (host ns, bytes written, bytes after noise, host was listening); None to record none."""
        self.interrupt_pending = False
        self.watched = -1
        """File descriptor of the terminal while it is polled, else -1."""
        self._clock, self._poll, self._counts, self._waits = clock, poll, counts, waits
        self._always_writable = model.platform == "esp32"
        self._emulated = settings.is_emulated
        self._interrupt_at = 0
        self._last_poll = 0.0
        self._on_uart = settings.uart_link is not None
        self._link_port = 0 if settings.uart_link is None else settings.uart_link + 1
        self._ports: dict[int, ByteStream] = {0: ByteStream()}
        self._ports[self._link_port] = ByteStream(link=link)
        if self._always_writable:
            self._ports[0].byte_ns, self._ports[0].send_buffer = CONSOLE_BYTE_NS, CONSOLE_FIFO
        self.start_interpreter()

    def start_interpreter(self) -> None:
        """Reset the interrupt character at the start of an interpreter.

        In an emulated processor MicroPython detects ctrl-C itself.
        """
        self._interrupt_char = -1 if self._emulated else CTRL_C

    def reset(self) -> None:
        """Clear all buffers, as at a restart of the processor."""
        for port in self._ports.values():
            port.clear()
        self.interrupt_pending = False

    def clear_link(self) -> None:
        """Clear the buffers of the link, after the emulated processor restarted itself."""
        self._ports[self._link_port].clear()

    def handlers(self) -> dict[int, Handler]:
        """Return the handlers of the calls served here."""
        return {Op.WRITE: self._write, Op.READ: self._read, Op.COUNT: self._count, Op.UART_INIT: self._uart}

    def unplug(self) -> bool:
        """Unplug the cable; return False if there is none."""
        if not isinstance(self.link, PtyLink):
            return False
        self.unwatch_terminal()
        self.link.unplug()
        self._ports[self._link_port].to_send.clear()
        self._counts["unplugged"] += 1
        return True

    def plug(self) -> None:
        """Plug the cable in again; the terminal gets a new name."""
        if isinstance(self.link, PtyLink):
            self.link.plug()

    @property
    def is_usb(self) -> bool:
        """True if the link is USB, which disconnects at a reset of the processor."""
        return isinstance(self.link, PtyLink) and not self._on_uart

    def unwatch_terminal(self) -> None:
        """Remove the terminal from the poll object."""
        if self.watched >= 0:
            self._poll.unregister(self.watched)
            self.watched = -1

    def watch_terminal(self) -> None:
        """Register the terminal while a host has it open and the board can receive."""
        if self._is_input_full or not self.link.is_host_open:
            self.unwatch_terminal()
            return
        fd = self.link.fileno()
        if fd != self.watched:
            self.unwatch_terminal()
            self._poll.register(fd, select.POLLIN)
            self.watched = fd

    def handle_poll_event(self, event: int) -> None:
        """Handle input or a hang-up of the terminal."""
        if event & select.POLLIN:
            self.read_input()
        if event & (select.POLLHUP | select.POLLERR):
            self.watch_terminal()

    def poll_host(self) -> None:
        """Check every few ms whether a host opened or closed the terminal."""
        now = time.monotonic()
        if now - self._last_poll > _HOST_POLL_S:
            self._last_poll = now
            self.watch_terminal()
            self.read_script()

    def read_script(self) -> None:
        """Read the input that a scripted host has sent by now."""
        if isinstance(self.link, MemoryLink):
            self.read_input()

    def read_input(self) -> None:
        """Read the bytes that the host has sent."""
        if isinstance(self.link, MemoryLink):
            self.link.t = self._clock.now() * 1e-9
        port = self._ports[self._link_port]
        if self._is_input_full:
            self.unwatch_terminal()
            return
        data = self.link.read()
        if not data:
            return
        self._counts["bytes_in"] += len(data)
        if self._link_port == 0 and self._interrupt_char >= 0 and self._interrupt_char in data:
            self._register_interrupt()
            data = data[data.rindex(self._interrupt_char) + 1 :]
        if self._on_uart:
            room = port.receive_buffer - len(port.received)
            self._counts["bytes_in_dropped"] += max(0, len(data) - room)
            data = data[:room]
        port.received += data

    @property
    def _is_input_full(self) -> bool:
        """True if the host has to wait: USB flow control stops it when the buffer is full.

        A UART has none.
        """
        port = self._ports[self._link_port]
        room = 1 if self._emulated else port.receive_buffer
        return (self._emulated or not self._on_uart) and len(port.received) >= room

    def send_pending(self) -> None:
        """Send pending output to the host, as much as the link accepts."""
        self._send(self._ports[self._link_port])

    def _send(self, port: ByteStream) -> None:
        """Send the pending output of a port, as much as its link accepts."""
        while port.on_wire and port.on_wire[0][0] <= self._clock.now():
            port.to_send += port.on_wire.popleft()[1]
        if port.to_send and port.link is not None:
            n = port.link.write(bytes(port.to_send))
            del port.to_send[:n]

    @property
    def has_pending_output(self) -> bool:
        """True if output to the host is pending."""
        return bool(self._ports[self._link_port].to_send)

    @property
    def next_uart_time(self) -> float:
        """Time at which the next bytes of a UART have been transmitted, ns."""
        port = self._ports[self._link_port]
        return port.on_wire[0][0] if port.on_wire else FOREVER

    @property
    def quiet_until(self) -> float:
        """Time up to which the host neither sends nor reads, ns; 0 if unknown.

        Only a scripted host is known.
        """
        port = self._ports[self._link_port]
        if not isinstance(self.link, MemoryLink) or port.to_send or port.on_wire:
            return 0.0
        return self.link.next_script_time * NS_PER_S

    def set_interrupt_char(self, interrupt_char: int) -> None:
        """Set the byte that interrupts the interpreter; -1 for none."""
        previous, received = self._interrupt_char, self._ports[0].received
        if interrupt_char == previous:
            return
        self._interrupt_char = interrupt_char
        # Input received before this call took effect.
        if interrupt_char >= 0 and interrupt_char in received:
            self._register_interrupt()
        elif interrupt_char < 0 and self.interrupt_pending:
            self.interrupt_pending = False
            received[:0] = bytes([previous])

    def _register_interrupt(self) -> None:
        """Register an interrupt character; earlier input is discarded, as by the ports of MicroPython."""
        self._ports[0].received.clear()
        if not self.interrupt_pending:
            self._interrupt_at = time.monotonic_ns()
        self.interrupt_pending = True

    def is_interrupt_ignored(self) -> bool:
        """Return True if ctrl-C has been pending for seconds without a call of the interpreter."""
        return self.interrupt_pending and time.monotonic_ns() - self._interrupt_at > BUSY_LOOP_NS

    def print_text(self, words: bytes) -> None:
        """Print a message of the board itself on standard output."""
        self._ports[0].to_send += words

    def flags(self) -> int:
        """Return the flags of a reply; a pending ctrl-C is reported once."""
        port = self._ports[0]
        flags = 0
        if port.received:
            flags |= FLAG_INPUT
        if len(port.to_send) < TX_FIFO or self._always_writable:
            flags |= FLAG_ROOM
        if self.interrupt_pending:
            flags |= FLAG_INTERRUPT
            self.interrupt_pending = False
        if self.link.is_host_open:
            flags |= FLAG_OPEN
        if self.link.is_plugged:
            flags |= FLAG_PLUGGED
        return flags

    def _port(self, number: int) -> ByteStream:
        """Return the stream of a port."""
        return self._ports.setdefault(number, ByteStream())

    def _write(self, argument: int, payload: bytes, t: float) -> Reply | Deferred:
        port = self._port(argument)
        if port.link is None:
            self._counts["console"] += len(payload)
            return Reply(port.put_on_wire(t, b"", len(payload)), len(payload))
        damaged = self.noise.apply(payload)
        if self.log is not None and payload:
            self.log.append((time.time_ns(), payload, damaged, self.link.is_host_open))
        self._counts["bytes_out"] += len(payload)
        if port.byte_ns:
            return Reply(port.put_on_wire(t, damaged, len(payload)), len(payload))
        port.to_send += damaged

        def poll_reply(late: bool) -> Reply | None:
            self._send(port)
            if len(port.to_send) > TX_FIFO:
                if not late:
                    return None
                self._counts["bytes_dropped"] += len(port.to_send) - TX_FIFO
                self._counts["writes_timed_out"] += 1
                del port.to_send[TX_FIFO:]
            return Reply(self._clock.now(), len(payload))

        return Deferred(WRITE_TIMEOUT_NS, poll_reply)

    def _read(self, argument: int, payload: bytes, t: float) -> Deferred:
        limit, wait_ms = struct.unpack("<Ii", payload)
        port = self._port(argument)
        if wait_ms and self._link_port == argument:
            self.watch_terminal()
            self.read_input()

        def poll_reply(late: bool) -> Reply | None:
            if not (port.received or late or self.interrupt_pending or wait_ms == 0):
                return None
            data = bytes(port.received[:limit])
            del port.received[:limit]
            return Reply(self._clock.now(), len(data), data)

        return Deferred(FOREVER if wait_ms < 0 else wait_ms * 1e6, poll_reply)

    def _count(self, argument: int, payload: bytes, t: float) -> Reply:
        if argument & 0x100:
            return Reply(t, int(self._waits(argument & 0xFF)))
        port = self._port(argument)
        room = COUNT_ROOM if port.free_space(t) > 0 or self._always_writable else 0
        return Reply(t, min(len(port.received), COUNT_MASK) | room)

    def _uart(self, argument: int, payload: bytes, t: float) -> Reply:
        port = self._port(argument)
        baud, port.send_buffer, port.receive_buffer = struct.unpack("<IHH", payload)
        port.byte_ns = 10e9 / max(1, baud)
        return Reply(t)
