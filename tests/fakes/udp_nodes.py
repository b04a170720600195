"""Nodes on UDP at 416 Hz in one thread, with or without keys, that count their samples."""

from __future__ import annotations

import select
import socket
import threading
import time
from dataclasses import replace

from fakes.sealed_node import SealedNode
from faults.line import HELLO
from hubowire import Frame, FrameDecoder, Message, decode, encode, encode_frame
from hubowire.messages import GetHello, Hello, ImuBatch, TimeReply, TimeRequest

RATE_HZ, BATCH = 416, 8
_PERIOD_NS = round(1e9 / RATE_HZ)
_TURN_S = 0.002
_OPEN_EVERY_S, _SILENT_S = 1.0, 2.5


class UdpNode:
    """One node; key: None to send plain frames from the start."""

    def __init__(self, to: tuple[str, int], serial: bytes, node_id: int, key: bytes | None) -> None:
        self.serial, self.samples_sent = serial, 0
        self.joined_s: float | None = None
        """Seconds from the last start until it could send."""
        self.sent: list[bytes] = []
        """Its handshakes and some of its data, for who wants to send them again."""
        self._to, self._node_id, self._key = to, node_id, key
        self._boot_id = 0
        self.start()

    def start(self) -> None:
        """Power on or restart the node: new socket, clock and counters from zero."""
        if self._boot_id:
            self.socket.close()
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.setblocking(False)
        self._boot_id += 1
        self._index, self._seqs = 0, dict[int, int]()
        self._begun = self._due = self._began_to_send = time.monotonic()
        self._open_at = self._last_received = self._begun
        self.joined_s = None
        self._sealed = None if self._key is None else SealedNode(self._key)
        if self._sealed is None:
            self._start_session()

    def turn(self, now: float) -> None:
        """Send all data that is due."""
        if (
            self._sealed is not None
            and now >= self._open_at
            and (self._sealed.session is None or now - self._last_received > _SILENT_S)
        ):
            self._open_at = now + _OPEN_EVERY_S
            self._send(self._sealed.opening())
        while self.joined_s is not None and self._due <= now:
            rows = tuple(
                (k % 1000, 0, -5, 0, k % 1000, 2049) for k in range(self._index, self._index + BATCH)
            )
            t_us = (self._index * _PERIOD_NS // 1000) % (1 << 30)
            self._send_message(ImuBatch(t_us, _PERIOD_NS, self._index & 0xFFFF, 160, 0, rows))
            self._index += BATCH
            self.samples_sent += BATCH
            self._due += BATCH * _PERIOD_NS * 1e-9

    def listen(self) -> None:
        """Receive one datagram of the host and answer it."""
        try:
            data = self.socket.recv(2048)
        except OSError:
            return
        received_us = self._now_us()
        if self._sealed is not None:
            proof = self._sealed.proof(data)
            if proof is not None:
                self._send(proof)
                return
            frames = self._sealed.open(data)
            if frames is None:
                return
            self._last_received = time.monotonic()
            if self.joined_s is None:
                self._start_session()
            data = frames
        for frame in FrameDecoder().feed(data):
            asked = decode(frame.type_id, frame.payload)
            if isinstance(asked, GetHello):
                self._hello()
            elif isinstance(asked, TimeRequest):
                self._send_message(TimeReply(asked.token, received_us, self._now_us()))

    def _start_session(self) -> None:
        self._due = self._began_to_send = time.monotonic()
        self.joined_s = self._due - self._begun
        self._hello()

    def _hello(self) -> None:
        hello: Hello = replace(HELLO, serial=self.serial, boot_id=self._boot_id, rate_mhz=RATE_HZ * 1000)
        self._send_message(hello)

    def _now_us(self) -> int:
        """Return the node's time, us; the samples of the first frame were measured before it."""
        since = time.monotonic() - self._began_to_send + BATCH * _PERIOD_NS * 1e-9
        return int(1e6 * since) % (1 << 30)

    def _send_message(self, message: Message) -> None:
        seq = self._seqs.get(message.type_id, 0)
        self._seqs[message.type_id] = (seq + 1) & 0xFFFF
        frame = encode_frame(Frame(message.type_id, self._node_id, seq, encode(message)))
        self._send(frame if self._sealed is None else self._sealed.seal(frame))

    def _send(self, data: bytes) -> None:
        if len(self.sent) < 1000:
            self.sent.append(data)
        self.socket.sendto(data, self._to)


class UdpNodes:
    """A thread that runs the nodes inside `with`; `restart` is carried out in it."""

    def __init__(self, to: tuple[str, int], keys: dict[bytes, bytes | None]) -> None:
        """Start with keys by serial of the board."""
        self.nodes = [UdpNode(to, serial, k + 1, key) for k, (serial, key) in enumerate(keys.items())]
        self._restart: list[UdpNode] = []
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> UdpNodes:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        for node in self.nodes:
            node.socket.close()

    def restart(self, node: UdpNode) -> None:
        """Restart a node as by a reset."""
        node.joined_s = None
        self._restart.append(node)

    def _run(self) -> None:
        while not self._ended.is_set():
            while self._restart:
                self._restart.pop().start()
            by_socket = {node.socket: node for node in self.nodes}
            for ready in select.select(list(by_socket), [], [], _TURN_S)[0]:
                by_socket[ready].listen()
            for node in self.nodes:
                node.turn(time.monotonic())
