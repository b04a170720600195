"""Chunks that wait for a log which takes them."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from hubodo.log.mcap_file import Compression, MessageIndexes


@dataclass(frozen=True, slots=True)
class HeldChunk:
    """What `McapFile.add_chunk` takes."""

    records: bytes
    indexes: MessageIndexes
    compression: Compression


class HeldChunks(deque[HeldChunk]):
    """The one that waits longest comes first."""

    @property
    def size(self) -> int:
        """Bytes in all of them."""
        return sum(len(held.records) for held in self)

    @property
    def messages(self) -> int:
        """How many messages are in all of them."""
        return sum(messages_in(held.indexes) for held in self)


def messages_in(indexes: MessageIndexes) -> int:
    """How many messages a chunk has."""
    return sum(len(times) for times, _ in indexes.values())
