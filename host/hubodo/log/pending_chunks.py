"""Queue of chunks that could not be written yet."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from hubodo.log.mcap_file import Compression, MessageIndexes


@dataclass(frozen=True, slots=True)
class PendingChunk:
    """The arguments of `McapFile.add_chunk`."""

    records: bytes
    indexes: MessageIndexes
    compression: Compression


class PendingChunks(deque[PendingChunk]):
    """A queue of pending chunks, oldest first."""

    @property
    def byte_count(self) -> int:
        """Total size of their records, bytes."""
        return sum(len(held.records) for held in self)

    @property
    def message_count(self) -> int:
        """Total number of messages."""
        return sum(count_messages(held.indexes) for held in self)


def count_messages(indexes: MessageIndexes) -> int:
    """Return the number of messages in a chunk."""
    return sum(len(times) for times, _ in indexes.values())
