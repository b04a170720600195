"""Ten million random and mutated bytes through both host decoders: no exception, bounded memory."""

import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest
from wire_strategies import dirty, drive

from hubodo.ingest.node.bulk import BulkDecoder
from hubodo.ingest.node.node_frames import group_by_node
from hubowire import Damage, FrameDecoder, PayloadError, decode

TOTAL = 10_000_000
PORTION = 1 << 16


def streaming(decoder: FrameDecoder, data: bytes) -> None:
    for frame in decoder.feed(data):
        try:
            decode(frame.type_id, frame.payload)
        except PayloadError:
            continue


def in_bulk(decoder: BulkDecoder, data: bytes) -> None:
    group_by_node(decoder.feed(data), lambda end: (end, np.zeros_like(end)))


def portions(seed: int):
    """Return random bytes, bytes rich in small codes and zeros, and mutated frames, in random portions."""
    rng = np.random.default_rng(seed)
    frames = drive(rng, 1500)
    left = TOTAL
    while left > 0:
        size = int(min(left, rng.integers(1, PORTION)))
        match rng.integers(0, 4):
            case 0:
                part = rng.integers(0, 256, size, dtype=np.uint8).tobytes()
            case 1:
                part = rng.integers(0, 12, size, dtype=np.uint8).tobytes()
            case _:
                at = int(rng.integers(0, len(frames)))
                part = dirty(frames[at : at + size], rng, float(rng.choice([0.001, 0.01, 0.1])))
        left -= len(part)
        yield part


@pytest.mark.parametrize("seed", [20_251])
@pytest.mark.parametrize(
    ("make", "feed", "bound"), [(FrameDecoder, streaming, 3 << 20), (BulkDecoder, in_bulk, 16 << 20)]
)
def test_ten_million_random_bytes_raise_no_exception_and_memory_is_bounded(
    make: Callable, feed: Callable, bound: int, seed: int
):
    print(f"seed {seed}")
    decoder = make()
    fed = 0
    feed(decoder, drive(np.random.default_rng(seed), 50))
    peaks = []
    for number, part in enumerate(portions(seed)):
        # Tracing slows every allocation, so it is on for one portion in eight.
        if number % 8 == 0:
            tracemalloc.start()
        feed(decoder, part)
        if number % 8 == 0:
            peaks.append(tracemalloc.get_traced_memory()[1])
            tracemalloc.stop()
        fed += len(part)
    damage: Damage = decoder.damage
    assert fed >= TOTAL
    assert max(peaks) < bound
    assert min(damage.crc, damage.cobs, damage.short, damage.oversize) > 100
    accounted = decoder.bytes_framed + damage.bytes_lost + decoder.idle_delimiters + decoder.pending_bytes
    assert decoder.bytes_in == accounted and decoder.pending_bytes < 250


@pytest.mark.parametrize("seed", [20_252])
def test_both_decoders_count_the_same_over_ten_million_bytes(seed: int):
    print(f"seed {seed}")
    one, many = FrameDecoder(), BulkDecoder()
    for part in portions(seed):
        frames, groups = one.feed(part), many.feed(part)
        assert sum(len(group.seq) for group in groups) == len(frames)
        assert many.damage == one.damage
        assert (many.bytes_framed, many.idle_delimiters, many.pending_bytes) == (
            one.bytes_framed,
            one.idle_delimiters,
            one.pending_bytes,
        )


@pytest.mark.parametrize("make", [FrameDecoder, BulkDecoder])
def test_the_buffer_between_chunks_never_exceeds_a_frame(make: Callable):
    decoder = make()
    tracemalloc.start()
    for _ in range(2000):
        decoder.feed(b"\x55" * 500)
    buffered, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert decoder.pending_bytes < 250 and buffered < 100_000
    assert decoder.damage.oversize == 1 and decoder.damage.bytes_lost == 1_000_000
