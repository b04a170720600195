"""The queue of chunks that could not be written yet."""

import numpy as np

from hubodo.log.pending_chunks import PendingChunk, PendingChunks, count_messages


def test_bytes_and_messages_are_summed_over_all_chunks_and_the_oldest_is_removed_first():
    indexes = {1: (np.arange(3), np.arange(3)), 2: (np.arange(2), np.arange(2))}
    queue = PendingChunks(PendingChunk(bytes(size), indexes, "none") for size in (100, 20))
    assert (count_messages(indexes), queue.message_count, queue.byte_count) == (5, 10, 120)
    assert len(queue.popleft().records) == 100 and queue.byte_count == 20
