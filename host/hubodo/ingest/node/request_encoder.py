"""Encoding of requests to a node without the byte that stops a booting MicroPython board."""

from __future__ import annotations

from functools import lru_cache

from hubowire import ANY_NODE, Frame, Message, encode, encode_frame
from hubowire.messages import GetHello, Reason, UpdatePiece

_REASON_TEXTS = {
    Reason.UNKNOWN_MESSAGE: "its firmware does not support the request; flash it with `hubodo flash`",
    Reason.BAD_VALUE: "invalid value",
    Reason.WHEEL_TURNS: "the wheel turns; hold it still, or choose a bias kind for a turning wheel",
    Reason.NO_IMU: "its IMU does not answer; see `hubodo doctor`",
    Reason.BUSY: "it is busy with an initialisation; wait until it is finished",
    Reason.NOT_STORED: "the setting could not be written to its flash",
    Reason.WHEEL_RESTS: "the wheel is stationary; turn it, or choose a bias kind for a stationary wheel",
}
_CTRL_C_BYTE = 0x03
_MAX_SEQUENCE_ATTEMPTS = 600


def describe_reason(reason: int) -> str:
    """Return why a node refuses a request and what to do about it."""
    known = _REASON_TEXTS.get(Reason(reason)) if reason in set(Reason) else None
    return known or f"reason {reason}, unknown to this host"


class RequestEncoder:
    """An encoder of requests to one node with sequence numbers.

    A booting MicroPython board interprets ctrl-C (0x03) as "stop the program". Sequence numbers of requests
    only need to be distinct, so they are incremented until the frame does not contain this byte.
    """

    def __init__(self, node_id: int) -> None:
        self._to = node_id if node_id != _CTRL_C_BYTE else ANY_NODE
        self._seq = 0

    def encode_request(self, message: Message) -> tuple[int, bytes]:
        """Return the sequence number and the bytes of a request, preceded by a delimiter."""
        payload = encode(message)
        # The bytes of a file may be any; they go to a running node, by packets.
        for _ in range(1 if isinstance(message, UpdatePiece) else _MAX_SEQUENCE_ATTEMPTS):
            self._seq = (self._seq + 1) & 0xFFFF
            data = encode_frame(Frame(message.type_id, self._to, self._seq, payload))
            if _CTRL_C_BYTE not in data:
                break
        return self._seq, b"\0" + data


@lru_cache(maxsize=256)
def identification_request(node_id: int) -> bytes:
    """Return the request for the Hello of a node id; cached, as a flood of unknown senders may need many."""
    return RequestEncoder(node_id).encode_request(GetHello())[1]
