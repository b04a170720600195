"""Requests of users to one node, such as a setting: sent, and logged with the answer of the node."""

from __future__ import annotations

from collections.abc import Callable

from hubodo.ingest.node.outputs import AnswerReceived
from hubodo.ingest.node.request_encoder import RequestEncoder, describe_reason
from hubodo.log.records import EventRecord, Sink
from hubodo.recording import Event
from hubowire import Message

_MAX_OPEN_REQUESTS = 16

SendBytes = Callable[[bytes], bool]


class UserRequests:
    """The open requests of users to one node; the oldest are forgotten if there are many."""

    def __init__(
        self, node: str, encoder: RequestEncoder, send: SendBytes, sink: Sink, now_ns: Callable[[], int]
    ) -> None:
        self._node = node
        self._encoder = encoder
        self._send = send
        self._sink = sink
        self._now_ns = now_ns
        self._descriptions: dict[tuple[int, int], str] = {}  # by message type and sequence number

    def send(self, message: Message, description: str) -> None:
        """Send a request; the request and its answer become events with this description."""
        seq, data = self._encoder.encode_request(message)
        if not self._send(data):
            self._log_event("request", f"{description}: not sent, the link is down")
            return
        while len(self._descriptions) >= _MAX_OPEN_REQUESTS:
            self._descriptions.pop(next(iter(self._descriptions)))
        self._descriptions[message.type_id, seq] = description
        self._log_event("request", f"{description}: sent")

    def handle_answer(self, answer: AnswerReceived) -> None:
        """Log the answer to an open request; other answers are ignored."""
        description = self._descriptions.pop((answer.request, answer.request_seq), None)
        if description is not None:
            outcome = "done" if answer.reason is None else f"refused: {describe_reason(answer.reason)}"
            self._log_event("answer", f"{description}: {outcome}")

    def _log_event(self, kind: str, text: str) -> None:
        event = Event(self._now_ns(), kind, self._node, f"{self._node}: {text}", {"node": self._node})
        self._sink.write_record(EventRecord(event))
