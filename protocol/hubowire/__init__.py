"""Wire protocol between a wheel node and its host."""

from hubowire.codec import PayloadError, decode, encode, hello_identity
from hubowire.fingerprint import FINGERPRINT
from hubowire.framing import MAX_FRAME, MAX_PAYLOAD, OVERHEAD, Damage, Frame, FrameDecoder, encode_frame
from hubowire.messages import ANY_NODE, MESSAGES, Message, node_name

__all__ = [
    "ANY_NODE",
    "FINGERPRINT",
    "MAX_FRAME",
    "MAX_PAYLOAD",
    "MESSAGES",
    "OVERHEAD",
    "Damage",
    "Frame",
    "FrameDecoder",
    "Message",
    "PayloadError",
    "decode",
    "encode",
    "encode_frame",
    "hello_identity",
    "node_name",
]
