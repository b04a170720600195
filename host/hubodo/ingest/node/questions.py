"""Requests to a node as bytes: numbered, and without the byte that stops a MicroPython board that boots."""

from __future__ import annotations

from functools import lru_cache

from hubowire import ANY_NODE, Frame, Message, encode, encode_frame
from hubowire.messages import GetHello, Reason

_REASONS = {
    Reason.UNKNOWN_MESSAGE: "its firmware does not know the request; flash it with `hubodo flash`",
    Reason.BAD_VALUE: "not a value that it can take",
    Reason.WHEEL_TURNS: "the wheel turns; hold it still, or choose a bias kind that lets it turn",
    Reason.NO_IMU: "no IMU answers it; see `hubodo doctor`",
    Reason.BUSY: "it is busy with an initialisation; wait for its end",
    Reason.NOT_STORED: "its flash did not take the setting",
    Reason.WHEEL_RESTS: "the wheel rests; turn it, or choose a bias kind for a wheel at rest",
}
_CTRL_C = 0x03
_TRIES = 600


def reason_words(reason: int) -> str:
    """Why a node refuses, and what to do about it."""
    known = _REASONS.get(Reason(reason)) if reason in set(Reason) else None
    return known or f"reason {reason}, which this host does not know"


class Questions:
    """Numbers the requests to one node.

    A MicroPython board takes ctrl-C for "stop the program" while it boots. Sequence numbers of requests
    carry no meaning but to tell them apart, so they are counted on until no such byte is in the frame.
    """

    def __init__(self, node_id: int) -> None:
        self._to = node_id if node_id != _CTRL_C else ANY_NODE
        self._seq = 0

    def wire(self, message: Message) -> tuple[int, bytes]:
        """The sequence number and the bytes of a request, a delimiter before them."""
        payload = encode(message)
        for _ in range(_TRIES):
            self._seq = (self._seq + 1) & 0xFFFF
            data = encode_frame(Frame(message.type_id, self._to, self._seq, payload))
            if _CTRL_C not in data:
                break
        return self._seq, b"\0" + data


@lru_cache(maxsize=256)
def identification_request(node_id: int) -> bytes:
    """Return what asks a sender with this node id for its Hello; the same each time, as a flood may ask."""
    return Questions(node_id).wire(GetHello())[1]
