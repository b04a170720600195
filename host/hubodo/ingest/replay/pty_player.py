"""Playing of frames to a pseudo serial port in real time, with answers to the requests of a recorder."""

from __future__ import annotations

import contextlib
import fcntl
import os
import select
import struct
import termios
import time
import tty
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from hubodo.errors import InputError
from hubodo.ingest.readiness import can_read, can_write
from hubodo.ingest.replay.log_frames import TimedFrame
from hubowire import Frame, FrameDecoder, Message, decode, encode, encode_frame
from hubowire.messages import GetHello, Hello, ImuBatch, Nack, Reason, TimeReply, TimeRequest

_TICK_PERIOD_US = 1 << 30
_POLL_S = 0.02
_MAX_CLOCK_ERROR_US = 500_000
_DRAIN_TIMEOUT_S = 3.0
_ANY_NODE = 0


@dataclass(slots=True)
class _PlayedNode:
    """A played node: its Hello, and its clock relative to the host clock."""

    hello: Hello | None = None
    device_us: int = 0
    host_ns: int | None = None


class PtyPlayer:
    """A pseudo serial port on which frames are played; a context manager.

    path: the device, or the symlink to it. Frames are played at their recorded intervals divided by `speed`,
    or as fast as the reader accepts them if it is 0. `GetHello` and `TimeRequest` are answered for the nodes;
    their clocks run `speed` times as fast as the host clock, so a recorder's times are correct at 1.
    """

    def __init__(self, link: Path | None, speed: float) -> None:
        """Open the port and create the symlink; raise InputError when the symlink cannot be created."""
        self.speed = speed
        self.frames = 0
        self.undelivered = 0
        self._master, slave = os.openpty()
        tty.setraw(slave)
        device = os.ttyname(slave)
        # Once opened and closed, the port reports with POLLHUP that no reader has it open.
        os.close(slave)
        os.set_blocking(self._master, False)
        self._device = device
        self._link = link
        if link is not None:
            if link.is_symlink() and not link.exists():
                link.unlink()  # left by a killed player
            try:
                link.symlink_to(device)
            except OSError as error:
                os.close(self._master)
                raise InputError(f"{link}: {error.strerror or error}; choose another --link") from None
        self.path = str(link) if link is not None else device
        self._decoder = FrameDecoder()
        self._nodes: dict[int, _PlayedNode] = {}
        self._seqs: dict[tuple[int, int], int] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._link is not None:
            self._link.unlink(missing_ok=True)
        os.close(self._master)

    def play(
        self,
        frames: Iterable[TimedFrame],
        is_stopped: Callable[[], bool],
        on_progress: Callable[[float], None],
    ) -> None:
        """Wait for a reader, then play; on_progress(t): called with the log time of each frame."""
        while not self._port_is_open():
            if is_stopped():
                return
            time.sleep(_POLL_S)
        start_ns: int | None = None
        t0 = 0.0
        for item in frames:
            if start_ns is None:
                start_ns, t0 = time.monotonic_ns(), item.t
            while not is_stopped():
                wait = 0.0
                if self.speed:
                    wait = (start_ns - time.monotonic_ns()) * 1e-9 + (item.t - t0) / self.speed
                self._read_requests(max(min(wait, _POLL_S), 0.0))
                if wait <= 0:
                    break
            if is_stopped():
                return
            on_progress(item.t)
            self._update_node(item.frame)
            self._send(item.data, is_stopped)
        self._drain(is_stopped)

    def _update_node(self, frame: Frame | None) -> None:
        if frame is None:
            return
        node = self._nodes.setdefault(frame.node, _PlayedNode())
        message = (
            decode(frame.type_id, frame.payload)
            if frame.type_id in (Hello.type_id, ImuBatch.type_id)
            else None
        )
        if isinstance(message, Hello):
            node.hello = message
        elif isinstance(message, ImuBatch) and message.samples:
            now = time.monotonic_ns()
            newest = message.t_us + (len(message.samples) - 1) * message.period_ns // 1000
            off = (
                newest - self._device_us(node, now) + _TICK_PERIOD_US // 2
            ) % _TICK_PERIOD_US - _TICK_PERIOD_US // 2
            if node.host_ns is None or abs(off) > _MAX_CLOCK_ERROR_US:
                node.device_us, node.host_ns = newest, now

    def _device_us(self, node: _PlayedNode, now_ns: int) -> int:
        since = 0 if node.host_ns is None else now_ns - node.host_ns
        return node.device_us + round(since * (self.speed or 1.0) / 1000)

    def _port_is_open(self) -> bool:
        poll = select.poll()
        poll.register(self._master, 0)
        return not any(event & select.POLLHUP for _, event in poll.poll(0))

    def _send(self, data: bytes, is_stopped: Callable[[], bool]) -> None:
        self.frames += 1
        unsent = memoryview(data)
        while unsent and not is_stopped():
            if not self._port_is_open():
                self.undelivered += 1
                return
            try:
                unsent = unsent[os.write(self._master, unsent) :]
            except BlockingIOError:
                self._read_requests(0.0)
                can_write(self._master, _POLL_S)

    def _read_requests(self, wait: float) -> None:
        if not can_read(self._master, wait):
            return
        try:
            data = os.read(self._master, 4096)
        except OSError:  # no reader has the port open
            time.sleep(wait)
            return
        now = time.monotonic_ns()
        for frame in self._decoder.feed(data):
            for number in [frame.node] if frame.node != _ANY_NODE else list(self._nodes):
                if number in self._nodes:
                    self._answer(number, self._nodes[number], frame, now)

    def _answer(self, number: int, node: _PlayedNode, frame: Frame, now_ns: int) -> None:
        message = (
            decode(frame.type_id, frame.payload) if len(frame.payload) >= 8 or not frame.payload else None
        )
        answer: Message
        if isinstance(message, GetHello):
            if node.hello is None:
                return
            answer = node.hello
        elif isinstance(message, TimeRequest):
            if node.host_ns is None:
                return
            device = self._device_us(node, now_ns) % _TICK_PERIOD_US
            answer = TimeReply(
                message.token, device, self._device_us(node, time.monotonic_ns()) % _TICK_PERIOD_US
            )
        else:
            answer = Nack(frame.type_id, frame.seq, Reason.BUSY, 0)
        key = (number, answer.type_id)
        seq = self._seqs.get(key, 0)
        self._seqs[key] = (seq + 1) & 0xFFFF
        with contextlib.suppress(BlockingIOError):
            os.write(self._master, encode_frame(Frame(answer.type_id, number, seq, encode(answer))))

    def _drain(self, is_stopped: Callable[[], bool]) -> None:
        """Wait until the reader has read all bytes, which would be lost when the port closes."""
        deadline = time.monotonic() + _DRAIN_TIMEOUT_S
        slave = os.open(self._device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            quiet = 0
            while quiet < 3 and time.monotonic() < deadline and not is_stopped():
                (waiting,) = struct.unpack("I", fcntl.ioctl(slave, termios.FIONREAD, bytes(4)))
                quiet = 0 if waiting else quiet + 1
                self._read_requests(_POLL_S)
        finally:
            os.close(slave)
