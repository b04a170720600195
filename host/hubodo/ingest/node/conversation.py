"""A talk with one node: who it is, what it is asked, and what it answers."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

from hubodo.errors import HubodoError, InputError, LinkError, WireMismatch
from hubodo.ingest.link.foreign_bytes import describe_foreign_bytes
from hubodo.ingest.link.open_link import LinkDown, Transport
from hubodo.ingest.link.ports import DeviceFinder, PortName
from hubodo.ingest.link.transport import open_transport
from hubodo.ingest.node.questions import Questions, reason_words
from hubowire import (
    FINGERPRINT,
    Frame,
    FrameDecoder,
    Message,
    PayloadError,
    decode,
    hello_identity,
    node_name,
)
from hubowire.messages import (
    Ack,
    AnyMessage,
    Filter,
    GetHello,
    Health,
    Hello,
    Nack,
    Reason,
    Reboot,
    RebootMode,
)

_READ_S = 0.05
_MEET_S = 4.0
_OTHERS_S = 0.4
_ANSWER_S = 1.0
_TRIES = 3
_REOPEN_S = 0.2
_SAMPLE_BYTES = 512


class NodeRefused(HubodoError):
    """A node said no."""


class PortGone(LinkError):
    """The port went away in the middle of a talk, as one does whose node starts anew."""


class Conversation:
    """One node behind a port; a context manager. hello, health, filter: the newest that it said of itself."""

    def __init__(self, port: PortName, baud: int, node_id: int | None = None) -> None:
        """node_id: which node where several share the line; None: the only one.

        Raises LinkError when the port cannot be opened.
        """
        self.node_id = node_id
        self.hello: Hello | None = None
        self.health: Health | None = None
        self.filter: Filter | None = None
        self._port, self._baud = port, baud
        self._finder = DeviceFinder(port)
        self._transport: Transport | None = open_transport(port, self._finder, baud)
        self._decoders: dict[str, FrameDecoder] = {}
        self._questions = Questions(node_id or 0)
        self._heard: set[int] = set()
        self._sender = ""
        self._strange = bytearray()
        self._bytes = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close()

    def meet(self) -> Hello:
        """Waits for the node to speak, then asks who it is.

        A node that boots must not be sent anything, so nothing is until it has spoken. Raises LinkError when
        nothing comes, or no frames; InputError when several nodes speak and none was chosen; WireMismatch
        when it was built from another message table.
        """
        self._wait(lambda: self._speaks(), _MEET_S)
        if self.node_id is None:
            self._wait(lambda: len(self._heard) > 1, _OTHERS_S)
            if len(self._heard) > 1:
                ids = ", ".join(f"{number} ({node_name(number)})" for number in sorted(self._heard))
                raise InputError(f"{self._port.text}: nodes {ids} are there; say which with --node-id")
        if not self._speaks():
            raise LinkError(f"{self._port.text}: {self._silence()}")
        if self.node_id is None:
            self.node_id = next(iter(self._heard))
            self._questions = Questions(self.node_id)
        hellos: list[Hello] = []

        def told(frame: Frame, said: AnyMessage) -> None:
            if isinstance(said, Hello):
                hellos.append(said)

        for _ in range(_TRIES):
            self._send(GetHello())
            if self._wait(lambda: bool(hellos), _ANSWER_S, told):
                return hellos[-1]
        raise LinkError(f"{self._port.text}: the node speaks but does not answer; unplug it, plug it in")

    def ask(self, message: Message, *, seconds: float = _ANSWER_S, tries: int = _TRIES) -> None:
        """Asks, and asks again after each silence of so many seconds.

        Raises InputError when the node finds a value bad, NodeRefused for its other reasons, LinkError when
        it never answers.
        """
        answers: list[Ack | Nack] = []
        asked: set[int] = set()

        def answered(frame: Frame, said: AnyMessage) -> None:
            if isinstance(said, Ack | Nack) and said.request == message.type_id and said.request_seq in asked:
                answers.append(said)

        for _ in range(tries):
            asked.add(self._send(message))
            if self._wait(lambda: bool(answers), seconds, answered):
                break
        name = type(message).__name__
        if not answers:
            raise LinkError(f"{self._port.text}: no answer to {name}; is the node still there?")
        if isinstance(answers[0], Nack):
            raise _refusal(self._port.text, name, answers[0])

    def now_called(self, node_id: int) -> None:
        """The node has another id from here on."""
        self.node_id, self._heard = node_id, set()
        self._questions = Questions(node_id)

    def wait(self, done: Callable[[], bool], seconds: float) -> bool:
        """Listens until `done` or so many seconds have gone by; whether it is done."""
        return self._wait(done, seconds)

    def restart(self, mode: RebootMode) -> None:
        """Has the node start anew; its port may go before the answer has been read. Raises as `ask` does."""
        with contextlib.suppress(PortGone):
            self.ask(Reboot(mode), tries=1)

    def again(self, seconds: float, boot_id: int) -> Hello:
        """The Hello of the start after that: the port may go and come back meanwhile. Raises LinkError."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            try:
                if self._transport is None:
                    self._transport = open_transport(self._port, self._finder, self._baud)
                if self._wait(lambda: self._started_since(boot_id), _REOPEN_S):
                    assert self.hello is not None
                    return self.hello
            except LinkError:
                self._close()
                time.sleep(_REOPEN_S)
        raise LinkError(f"{self._port.text}: no Hello {seconds:.0f} s after the restart; see `hubodo doctor`")

    def _started_since(self, boot_id: int) -> bool:
        return self.hello is not None and self.hello.boot_id != boot_id

    def _speaks(self) -> bool:
        return bool(self._heard) if self.node_id is None else self.node_id in self._heard

    def _silence(self) -> str:
        if self._heard:
            ids = ", ".join(map(str, sorted(self._heard)))
            return f"node {self.node_id} does not speak; there: {ids}"
        if not self._bytes:
            return f"nothing came for {_MEET_S:.0f} s; is the node powered, and its program running?"
        return describe_foreign_bytes(bytes(self._strange), self._bytes)

    def _send(self, message: Message) -> int:
        seq, data = self._questions.wire(message)
        try:
            if self._transport is not None:
                self._transport.write(data, self._sender)
        except LinkDown as down:
            raise PortGone(str(down)) from None
        return seq

    def _wait(
        self,
        done: Callable[[], bool],
        seconds: float,
        watch: Callable[[Frame, AnyMessage], None] = lambda frame, message: None,
    ) -> bool:
        end = time.monotonic() + seconds
        while not done():
            left = end - time.monotonic()
            if left <= 0 or self._transport is None:
                return False
            try:
                data, sender = self._transport.read(min(left, _READ_S))
            except LinkDown as down:
                raise PortGone(str(down)) from None
            self._bytes += len(data)
            self._strange += data[: _SAMPLE_BYTES - len(self._strange)]
            for frame in self._decoders.setdefault(sender, FrameDecoder()).feed(data) if data else ():
                self._heard.add(frame.node)
                if self.node_id in (None, frame.node):
                    self._sender = sender
                    message = self._take(frame)
                    if message is not None:
                        watch(frame, message)
        return True

    def _take(self, frame: Frame) -> AnyMessage | None:
        try:
            if frame.type_id == Hello.type_id and self.node_id is not None:
                fingerprint, version = hello_identity(frame.payload)
                if fingerprint != FINGERPRINT:
                    raise WireMismatch(
                        f"{self._port.text}: the node speaks {fingerprint:08x} (firmware "
                        f"{'.'.join(map(str, version))}), host speaks {FINGERPRINT:08x}: flash it with "
                        "`hubodo flash`, or install its hubodo"
                    )
            message = decode(frame.type_id, frame.payload)
        except PayloadError:
            return None
        if isinstance(message, Hello):
            self.hello = message
        elif isinstance(message, Health):
            self.health = message
        elif isinstance(message, Filter):
            self.filter = message
        return message

    def _close(self) -> None:
        if self._transport is not None:
            self._transport.close()
            self._transport = None


def _refusal(port: str, name: str, answer: Nack) -> HubodoError:
    detail = f" ({answer.detail})" if answer.detail else ""
    text = f"{port}: the node refuses {name}: {reason_words(answer.reason)}{detail}"
    return InputError(text) if answer.reason == Reason.BAD_VALUE else NodeRefused(text)
