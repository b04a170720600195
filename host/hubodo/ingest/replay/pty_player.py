"""Frames onto a pseudo serial port in their own time, with answers to what a recorder asks."""

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
from hubodo.ingest.replay.replay import TimedFrame
from hubowire import Frame, FrameDecoder, Message, decode, encode, encode_frame
from hubowire.messages import GetHello, Hello, ImuBatch, Nack, Reason, TimeReply, TimeRequest

_PERIOD_US = 1 << 30
_POLL_S = 0.02
_JUMP_US = 500_000
_DRAIN_S = 3.0
_ANY_NODE = 0


@dataclass(slots=True)
class _Played:
    """One node as the player stands in for it: its Hello, and its clock tied to ours."""

    hello: Hello | None = None
    device_us: int = 0
    at_ns: int | None = None


class PtyPlayer:
    """A pseudo serial port on which frames are played; a context manager.

    path: the device of the moment, or the symlink to it. Frames come at their own distances divided by
    `speed`, or as fast as the reader takes them where it is 0. `GetHello` and `TimeRequest` are answered
    for the nodes; their clocks run `speed` times as fast as ours, so a recorder's times are right at 1.
    """

    def __init__(self, link: Path | None, speed: float) -> None:
        """Raises InputError when the symlink cannot be made."""
        self.speed = speed
        self.frames = 0
        self.unheard = 0
        self._master, slave = os.openpty()
        tty.setraw(slave)
        device = os.ttyname(slave)
        # Once opened and closed, the port says with POLLHUP whether anybody has it open.
        os.close(slave)
        os.set_blocking(self._master, False)
        self._device = device
        self._link = link
        if link is not None:
            if link.is_symlink() and not link.exists():
                link.unlink()  # left by a player that was killed
            try:
                link.symlink_to(device)
            except OSError as error:
                os.close(self._master)
                raise InputError(f"{link}: {error.strerror or error}; choose another --link") from None
        self.path = str(link) if link is not None else device
        self._decoder = FrameDecoder()
        self._nodes: dict[int, _Played] = {}
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
        self, frames: Iterable[TimedFrame], stopped: Callable[[], bool], tick: Callable[[float], None]
    ) -> None:
        """Waits for a reader, then plays; tick(t) is called as the log's time goes on."""
        while not self._heard():
            if stopped():
                return
            time.sleep(_POLL_S)
        start_ns: int | None = None
        t0 = 0.0
        for item in frames:
            if start_ns is None:
                start_ns, t0 = time.monotonic_ns(), item.t
            while not stopped():
                wait = 0.0
                if self.speed:
                    wait = (start_ns - time.monotonic_ns()) * 1e-9 + (item.t - t0) / self.speed
                self._listen(max(min(wait, _POLL_S), 0.0))
                if wait <= 0:
                    break
            if stopped():
                return
            tick(item.t)
            self._know(item.frame)
            self._send(item.data, stopped)
        self._drain(stopped)

    def _know(self, frame: Frame | None) -> None:
        if frame is None:
            return
        node = self._nodes.setdefault(frame.node, _Played())
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
            off = (newest - self._device_us(node, now) + _PERIOD_US // 2) % _PERIOD_US - _PERIOD_US // 2
            if node.at_ns is None or abs(off) > _JUMP_US:
                node.device_us, node.at_ns = newest, now

    def _device_us(self, node: _Played, now_ns: int) -> int:
        since = 0 if node.at_ns is None else now_ns - node.at_ns
        return node.device_us + round(since * (self.speed or 1.0) / 1000)

    def _heard(self) -> bool:
        poll = select.poll()
        poll.register(self._master, 0)
        return not any(event & select.POLLHUP for _, event in poll.poll(0))

    def _send(self, data: bytes, stopped: Callable[[], bool]) -> None:
        self.frames += 1
        rest = memoryview(data)
        while rest and not stopped():
            if not self._heard():
                self.unheard += 1
                return
            try:
                rest = rest[os.write(self._master, rest) :]
            except BlockingIOError:
                self._listen(0.0)
                can_write(self._master, _POLL_S)

    def _listen(self, wait: float) -> None:
        if not can_read(self._master, wait):
            return
        try:
            data = os.read(self._master, 4096)
        except OSError:  # nobody has the port open
            time.sleep(wait)
            return
        now = time.monotonic_ns()
        for frame in self._decoder.feed(data):
            for number in [frame.node] if frame.node != _ANY_NODE else list(self._nodes):
                if number in self._nodes:
                    self._answer(number, self._nodes[number], frame, now)

    def _answer(self, number: int, node: _Played, frame: Frame, now_ns: int) -> None:
        message = (
            decode(frame.type_id, frame.payload) if len(frame.payload) >= 8 or not frame.payload else None
        )
        answer: Message
        if isinstance(message, GetHello):
            if node.hello is None:
                return
            answer = node.hello
        elif isinstance(message, TimeRequest):
            if node.at_ns is None:
                return
            device = self._device_us(node, now_ns) % _PERIOD_US
            answer = TimeReply(message.token, device, self._device_us(node, time.monotonic_ns()) % _PERIOD_US)
        else:
            answer = Nack(frame.type_id, frame.seq, Reason.BUSY, 0)
        key = (number, answer.type_id)
        seq = self._seqs.get(key, 0)
        self._seqs[key] = (seq + 1) & 0xFFFF
        with contextlib.suppress(BlockingIOError):
            os.write(self._master, encode_frame(Frame(answer.type_id, number, seq, encode(answer))))

    def _drain(self, stopped: Callable[[], bool]) -> None:
        """Waits until the reader has taken all: what is in the port when it goes is lost."""
        deadline = time.monotonic() + _DRAIN_S
        slave = os.open(self._device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            quiet = 0
            while quiet < 3 and time.monotonic() < deadline and not stopped():
                (waiting,) = struct.unpack("I", fcntl.ioctl(slave, termios.FIONREAD, bytes(4)))
                quiet = 0 if waiting else quiet + 1
                self._listen(_POLL_S)
        finally:
            os.close(slave)
