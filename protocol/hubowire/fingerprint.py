"""Fingerprint of the message table: two ends with equal fingerprints are compatible."""

import hashlib
from collections.abc import Iterable
from enum import IntEnum

from hubowire.messages import ENUMS, MESSAGES, Message, wire_fields


def canonical_text(
    messages: Iterable[type[Message]] = MESSAGES, enums: Iterable[type[IntEnum]] = ENUMS
) -> str:
    """Return the text that the fingerprint covers: names, types, scales, units and codes.

    One line per message, field and enum, separated by "\\n". Descriptions are not covered.
    """
    lines = []
    for message in messages:
        lines.append(f"message {message.type_id} {message.__name__}")
        lines += [f"{row.name} {row.type} {row.scale} {row.unit}" for row in wire_fields(message)]
    for enum in enums:
        lines.append(f"enum {enum.__name__} " + " ".join(f"{item.name}={item.value}" for item in enum))
    return "\n".join(lines)


def fingerprint(text: str) -> int:
    """Return the first four bytes of the SHA-256 of a canonical text, as a little-endian u32."""
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "little")


FINGERPRINT = fingerprint(canonical_text())
