"""A dialogue with one node: identification, requests and answers."""

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
from hubodo.ingest.node.request_encoder import RequestEncoder, describe_reason
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
    UpdatePiece,
    UpdateStart,
    UpdateState,
)

_POLL_TIMEOUT_S = 0.05
_FIRST_FRAME_TIMEOUT_S = 4.0
_OTHER_NODES_WAIT_S = 0.4
_ANSWER_TIMEOUT_S = 1.0
_MAX_REQUEST_ATTEMPTS = 3
_REOPEN_INTERVAL_S = 0.2
_FOREIGN_SAMPLE_BYTES = 512


class NodeRefused(HubodoError):
    """Raised when a node refuses a request."""


class PortGone(LinkError):
    """Raised when the port is lost during the dialogue, as it is when the node restarts."""


class Conversation:
    """A dialogue with one node on a port; a context manager.

    hello, health, filter: the newest messages of these types from the node. any_version: True while the
    `Hello` of a node with another message table is ignored instead of raising WireMismatch.
    """

    def __init__(self, port: PortName, baud: int, node_id: int | None = None) -> None:
        """Open the port; node_id: the node where several share the line, None for the only one.

        Raises LinkError when the port cannot be opened.
        """
        self.node_id = node_id
        self.hello: Hello | None = None
        self.health: Health | None = None
        self.filter: Filter | None = None
        self.any_version = False
        self._port, self._baud = port, baud
        self._finder = DeviceFinder(port)
        self._transport: Transport | None = open_transport(port, self._finder, baud)
        self._decoders: dict[str, FrameDecoder] = {}
        self._request_encoder = RequestEncoder(node_id or 0)
        self._received_ids: set[int] = set()
        self._identities: list[tuple[int, tuple[int, ...]]] = []
        self._sender = ""
        self._first_bytes = bytearray()
        self._byte_count = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close()

    def find(self) -> None:
        """Wait for a frame of the node.

        Nothing must be sent to a node during its boot, so nothing is sent before its first frame. Raises
        LinkError when no frame is received; InputError when several nodes are received and none was chosen.
        """
        self._wait(lambda: self._is_received(), _FIRST_FRAME_TIMEOUT_S)
        if self.node_id is None:
            self._wait(lambda: len(self._received_ids) > 1, _OTHER_NODES_WAIT_S)
            if len(self._received_ids) > 1:
                ids = ", ".join(f"{number} ({node_name(number)})" for number in sorted(self._received_ids))
                raise InputError(f"{self._port.text}: nodes {ids} are present; choose one with --node-id")
        if not self._is_received():
            raise LinkError(f"{self._port.text}: {self._describe_silence()}")
        if self.node_id is None:
            self.node_id = next(iter(self._received_ids))
            self._request_encoder = RequestEncoder(self.node_id)

    def identify(self) -> Hello:
        """Wait for a frame of the node, then request and return its Hello.

        Raises as `find` does, and WireMismatch when the node was built from another message table.
        """
        self.find()
        hellos: list[Hello] = []

        def collect_hello(frame: Frame, reply: AnyMessage) -> None:
            if isinstance(reply, Hello):
                hellos.append(reply)

        for _ in range(_MAX_REQUEST_ATTEMPTS):
            self._send(GetHello())
            if self._wait(lambda: bool(hellos), _ANSWER_TIMEOUT_S, collect_hello):
                return hellos[-1]
        raise LinkError(
            f"{self._port.text}: the node sends frames but does not answer; unplug it and plug it in again"
        )

    def request(
        self, message: Message, *, timeout_s: float = _ANSWER_TIMEOUT_S, attempts: int = _MAX_REQUEST_ATTEMPTS
    ) -> None:
        """Send a request, repeat it after each timeout, and return once it is acknowledged.

        Raises InputError when the node rejects a value, NodeRefused for its other reasons, LinkError when
        it does not answer.
        """
        answers: list[Ack | Nack] = []
        request_seqs: set[int] = set()

        def collect_answer(frame: Frame, reply: AnyMessage) -> None:
            if (
                isinstance(reply, Ack | Nack)
                and reply.request == message.type_id
                and reply.request_seq in request_seqs
            ):
                answers.append(reply)

        for _ in range(attempts):
            request_seqs.add(self._send(message))
            if self._wait(lambda: bool(answers), timeout_s, collect_answer):
                break
        name = type(message).__name__
        if not answers:
            raise LinkError(f"{self._port.text}: no answer to {name}; is the node still connected?")
        if isinstance(answers[0], Nack):
            raise _refusal_error(self._port.text, name, answers[0])

    def ask(
        self,
        message: UpdateStart | UpdatePiece | None,
        timeout_s: float,
        is_new: Callable[[UpdateState], bool] = lambda state: True,
    ) -> UpdateState | None:
        """Send a message of an update, if any; return the first new state, None without one in time.

        A lost port is opened again. Raises NodeRefused when the firmware of the node has no updates.
        """
        states: list[UpdateState] = []
        refusals: list[Nack] = []

        def collect(frame: Frame, reply: AnyMessage) -> None:
            if isinstance(reply, UpdateState) and is_new(reply):
                states.append(reply)
            elif isinstance(reply, Nack) and reply.request == UpdateStart.type_id:
                refusals.append(reply)

        try:
            if self._transport is None:
                self._transport = open_transport(self._port, self._finder, self._baud)
            if message is not None:
                self._send(message)
            self._wait(lambda: bool(states or refusals), timeout_s, collect)
        except LinkError:
            self._close()
            time.sleep(_REOPEN_INTERVAL_S)
        if refusals:
            raise _refusal_error(self._port.text, UpdateStart.__name__, refusals[0])
        return states[0] if states else None

    def wait_identity(self, timeout_s: float) -> tuple[int, tuple[int, ...]]:
        """Request a `Hello`; return fingerprint and version of a node of any version. Raises LinkError."""
        self._identities.clear()
        end = time.monotonic() + timeout_s
        while time.monotonic() < end:
            self._send(GetHello())
            if self._wait(lambda: bool(self._identities), _ANSWER_TIMEOUT_S):
                return self._identities[-1]
        raise LinkError(f"{self._port.text}: no Hello in {timeout_s:.0f} s")

    def set_node_id(self, node_id: int) -> None:
        """Address the node by another id from now on."""
        self.node_id, self._received_ids = node_id, set()
        self._request_encoder = RequestEncoder(node_id)

    def wait_until(self, done: Callable[[], bool], timeout_s: float) -> bool:
        """Receive until `done` returns True or the timeout; return whether it did."""
        return self._wait(done, timeout_s)

    def restart_node(self, mode: RebootMode) -> None:
        """Restart the node; its port may disappear before the answer is read. Raises as `request` does."""
        with contextlib.suppress(PortGone):
            self.request(Reboot(mode), attempts=1)

    def wait_for_restart(self, timeout_s: float, boot_id: int) -> Hello:
        """Return the first Hello after a restart, reopening the port if necessary. Raises LinkError."""
        end = time.monotonic() + timeout_s
        while time.monotonic() < end:
            try:
                if self._transport is None:
                    self._transport = open_transport(self._port, self._finder, self._baud)
                if self._wait(lambda: self._has_restarted(boot_id), _REOPEN_INTERVAL_S):
                    assert self.hello is not None
                    return self.hello
            except LinkError:
                self._close()
                time.sleep(_REOPEN_INTERVAL_S)
        raise LinkError(
            f"{self._port.text}: no Hello {timeout_s:.0f} s after the restart; see `hubodo doctor`"
        )

    def _has_restarted(self, boot_id: int) -> bool:
        return self.hello is not None and self.hello.boot_id != boot_id

    def _is_received(self) -> bool:
        return bool(self._received_ids) if self.node_id is None else self.node_id in self._received_ids

    def _describe_silence(self) -> str:
        if self._received_ids:
            ids = ", ".join(map(str, sorted(self._received_ids)))
            return f"node {self.node_id} is not received; received: {ids}"
        refused = self._transport.refused if self._transport is not None else None
        if not self._byte_count and refused:
            causes = ", ".join(f"{count} {cause}" for cause, count in refused.items())
            return f"no packet is authentic ({causes}); is the key file that of the node?"
        if not self._byte_count:
            return f"no data for {_FIRST_FRAME_TIMEOUT_S:.0f} s; is the node powered and its program running?"
        return describe_foreign_bytes(bytes(self._first_bytes), self._byte_count)

    def _send(self, message: Message) -> int:
        seq, data = self._request_encoder.encode_request(message)
        try:
            if self._transport is not None:
                self._transport.write(data, self._sender)
        except LinkDown as down:
            raise PortGone(str(down)) from None
        return seq

    def _wait(
        self,
        done: Callable[[], bool],
        timeout_s: float,
        on_message: Callable[[Frame, AnyMessage], None] = lambda frame, message: None,
    ) -> bool:
        end = time.monotonic() + timeout_s
        while not done():
            remaining_s = end - time.monotonic()
            if remaining_s <= 0 or self._transport is None:
                return False
            try:
                data, sender = self._transport.read(min(remaining_s, _POLL_TIMEOUT_S))
            except LinkDown as down:
                raise PortGone(str(down)) from None
            self._byte_count += len(data)
            self._first_bytes += data[: _FOREIGN_SAMPLE_BYTES - len(self._first_bytes)]
            for frame in self._decoders.setdefault(sender, FrameDecoder()).feed(data) if data else ():
                self._received_ids.add(frame.node)
                if self.node_id in (None, frame.node):
                    self._sender = sender
                    message = self._decode_frame(frame)
                    if message is not None:
                        on_message(frame, message)
        return True

    def _decode_frame(self, frame: Frame) -> AnyMessage | None:
        try:
            if frame.type_id == Hello.type_id and self.node_id is not None:
                fingerprint, version = hello_identity(frame.payload)
                self._identities.append((fingerprint, version))
                if fingerprint != FINGERPRINT and self.any_version:
                    return None
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


def _refusal_error(port: str, name: str, answer: Nack) -> HubodoError:
    detail = f" ({answer.detail})" if answer.detail else ""
    text = f"{port}: the node refuses {name}: {describe_reason(answer.reason)}{detail}"
    return InputError(text) if answer.reason == Reason.BAD_VALUE else NodeRefused(text)
