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
OnOutcome = Callable[[bool, str], None]
"""Called with success and a word for people once the node has answered or cannot be asked."""


def ignore_outcome(success: bool, text: str) -> None:
    """Ignore an outcome: it is logged anyway."""


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
        # Description and listener by message type and sequence number.
        self._open: dict[tuple[int, int], tuple[str, OnOutcome]] = {}

    def send(self, message: Message, description: str, on_outcome: OnOutcome = ignore_outcome) -> None:
        """Send a request; the request and its answer become events with this description."""
        seq, data = self._encoder.encode_request(message)
        if not self._send(data):
            self._log_event("request", f"{description}: not sent, the link is down")
            on_outcome(False, "the link is down")
            return
        while len(self._open) >= _MAX_OPEN_REQUESTS:
            self._open.pop(next(iter(self._open)))
        self._open[message.type_id, seq] = description, on_outcome
        self._log_event("request", f"{description}: sent")

    def handle_answer(self, answer: AnswerReceived) -> None:
        """Log the answer to an open request; other answers are ignored."""
        request = self._open.pop((answer.request, answer.request_seq), None)
        if request is not None:
            description, on_outcome = request
            outcome = "done" if answer.reason is None else f"refused: {describe_reason(answer.reason)}"
            self._log_event("answer", f"{description}: {outcome}")
            on_outcome(answer.reason is None, outcome)

    def _log_event(self, kind: str, text: str) -> None:
        event = Event(self._now_ns(), kind, self._node, f"{self._node}: {text}", {"node": self._node})
        self._sink.write_record(EventRecord(event))
