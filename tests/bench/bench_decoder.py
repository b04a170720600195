"""Messages decoded per second by the code that users run, from bytes to timed samples, beside pymavlink.

"decode again" is what `hubodo import LOG` runs: many frames at once, by node, to samples in SI units with
device times, losses counted, each gap with its cause. "record" is what `hubodo record` runs for each read:
the same, frame by frame. pymavlink stops at its message objects. All decode the same samples: one sample per
message as ImuBatch and as MAVLink RAW_IMU, and our batches of 8 and 16 with the same payload bytes inside
MAVLink ENCAPSULATED_DATA. All get the same damage: each byte is replaced with the same probability, and cuts
and insertions are equally frequent per byte. Counted are intact messages per second of processor time; the
decoders take turns. Peak memory is beyond that of the stream, in a run of its own.
"""

import argparse
import json
import statistics
import sys
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / part) for part in ("host", "protocol", "tests/protocol")]

from pymavlink.dialects.v20 import common as mavlink  # noqa: E402
from speedups import record_speedup  # noqa: E402
from wire_strategies import dirty  # noqa: E402

from hubodo.ingest.node.bulk import BulkDecoder  # noqa: E402
from hubodo.ingest.node.decoder import NodeDecoder  # noqa: E402
from hubodo.ingest.node.gaps import LinkCounts  # noqa: E402
from hubodo.ingest.node.node_frames import group_by_node  # noqa: E402
from hubodo.ingest.node.run_decoder import RunDecoder  # noqa: E402
from hubowire import FINGERPRINT, Frame, FrameDecoder, encode, encode_frame  # noqa: E402
from hubowire.messages import Hello, ImuBatch  # noqa: E402

PERIOD_NS = 4_807_692
# A file is read in large portions and a port in small ones; pymavlink was fastest with small ones.
LOG_PORTION, PORT_PORTION = 1 << 20, 1 << 12


@dataclass(frozen=True, slots=True)
class Row:
    """Result of one decoder on one stream; medians over the repeats; ratio: speed relative to pymavlink."""

    stream: str
    dirt: float
    decoder: str
    frame_bytes: float
    messages_in: int
    messages_out: int
    messages_per_s: float
    samples_per_s: float
    peak_bytes: int
    ratio: float
    ratios: tuple[float, ...]
    """Ratio of each round."""


def samples(rng: np.random.Generator, count: int) -> list[tuple[int, ...]]:
    """Return raw samples of a wheel at 8 rad/s: small transverse rates, spin, rotating gravity."""
    theta = np.arange(count) * 8.0 / 208
    mean = np.stack(
        [theta * 0, theta * 0, theta * 0 + 6548, 2049 * np.cos(theta), -2049 * np.sin(theta), theta * 0]
    )
    raw = np.rint(mean.T + rng.normal(0, (3, 3, 3, 12, 12, 12), (count, 6)))
    return [tuple(row) for row in raw.astype(int).tolist()]


def our_payloads(some: list[tuple[int, ...]], batch: int) -> list[bytes]:
    """Return ImuBatch payloads of `batch` samples."""
    period_us = PERIOD_NS / 1000
    return [
        encode(
            ImuBatch(
                round(at * period_us) % 2**30, PERIOD_NS, at % 2**16, -48, 0, tuple(some[at : at + batch])
            )
        )
        for at in range(0, len(some), batch)
    ]


HELLO = Hello(
    FINGERPRINT, (0, 1, 0), b"bench001", 7, 3, 1, 208_000, 2000, 16,
    70_000_000, 488_000, 62_500, 25_000_000, 0, 16, 1, 40,
)  # fmt: skip
HELLO_S = 5.0


def our_stream(payloads: list[bytes], seconds: float) -> bytes:
    """Return the batches, with Hello at the start and every few seconds as a node sends it."""
    every = max(1, int(len(payloads) / seconds * HELLO_S))
    out = bytearray()
    for seq, body in enumerate(payloads):
        if seq % every == 0:
            out += encode_frame(Frame(Hello.type_id, 1, seq // every, encode(HELLO)))
        out += encode_frame(Frame(ImuBatch.type_id, 1, seq % 2**16, body))
    return bytes(out)


def raw_imu_stream(some: list[tuple[int, ...]]) -> bytes:
    """Return the same samples, time and temperature as MAVLink 2 RAW_IMU."""
    out, sender = bytearray(), mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    for n, (gx, gy, gz, ax, ay, az) in enumerate(some):
        message = mavlink.MAVLink_raw_imu_message(
            n * PERIOD_NS // 1000, ax, ay, az, gx, gy, gz, 0, 0, 0, id=1, temperature=-48
        )
        out += message.pack(sender)
        sender.seq = (sender.seq + 1) % 256
    return bytes(out)


def encapsulated_stream(payloads: list[bytes]) -> bytes:
    """Return the same payload bytes in MAVLink 2 ENCAPSULATED_DATA, without trailing zeros."""
    out, sender = bytearray(), mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    for seq, body in enumerate(payloads):
        data = list(body.ljust(253, b"\0"))
        out += mavlink.MAVLink_encapsulated_data_message(seq % 2**16, data).pack(sender)
        sender.seq = (sender.seq + 1) % 256
    return bytes(out)


T0 = 1_700_000_000_000_000_000


def run_again(stream: bytes, damaged: np.ndarray, portion: int, ns_per_byte: float, batch: int) -> int:
    """Decode many frames at once; each arrives when its samples were taken."""

    def arrival(end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return T0 + (end * ns_per_byte).astype(np.int64), np.searchsorted(damaged, end)

    decoder, node = BulkDecoder(), RunDecoder("left")
    for at in range(0, len(stream), portion):
        for number, some in group_by_node(decoder.feed(stream[at : at + portion]), arrival).items():
            if number == 1:
                for _ in node.decode_many(some, 0):
                    pass
    return node.counts.samples // batch


def run_record(stream: bytes, damaged: np.ndarray, portion: int, ns_per_byte: float, batch: int) -> int:
    """Decode frame by frame."""
    decoder, node = FrameDecoder(), NodeDecoder("left")
    for at in range(0, len(stream), portion):
        t_ns = T0 + int((at + portion) * ns_per_byte)
        for frame in decoder.feed(stream[at : at + portion]):
            if frame.node == 1:
                for _ in node.decode_frame(frame, t_ns, LinkCounts(decoder.damage.frames)):
                    pass
    return node.counts.samples // batch


def run_pymavlink(stream: bytes, damaged: np.ndarray, portion: int) -> int:
    decoder, count = mavlink.MAVLink(None), 0
    decoder.robust_parsing = True
    for at in range(0, len(stream), portion):
        parsed = decoder.parse_buffer(stream[at : at + portion])
        count += sum(message.get_type() != "BAD_DATA" for message in parsed or ())
    return count


@dataclass(frozen=True, slots=True)
class Contestant:
    """A decoder with its stream and number of messages."""

    name: str
    run: Callable[[bytes, np.ndarray, int], int]
    clean: bytes
    messages: int
    portion: int


def damaged_pieces(stream: bytes) -> np.ndarray:
    """Return the ends of the pieces between delimiters that are not frames."""
    decoder, ends, at = FrameDecoder(), [], 0
    for piece in stream.split(b"\0"):
        at += len(piece) + 1
        if piece and decoder.decode_frame(piece) is None:
            ends.append(at)
    return np.array(ends, np.int64)


def peak_bytes(one: Contestant, stream: bytes, damaged: np.ndarray) -> int:
    """Return the peak memory beyond the stream, in a run of its own."""
    tracemalloc.start()
    one.run(stream[: 4 << 20], damaged, one.portion)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


def contest(
    contestants: list[Contestant], dirt: float, repeats: int, seed: int
) -> list[tuple[int, list[float], int]]:
    """Return messages, processor seconds of each round and peak bytes of each decoder.

    The decoders take turns in rounds and processor time is counted, so that other work on the machine affects
    all.
    """
    rng_seed = seed + 1
    streams = [dirty(one.clean, np.random.default_rng(rng_seed), dirt, splices=False) for one in contestants]
    damaged = [damaged_pieces(stream) for stream in streams]
    counts, seconds = [0] * len(streams), [[0.0] * repeats for _ in streams]
    for turn in range(repeats):
        for n, (one, stream) in enumerate(zip(contestants, streams, strict=True)):
            start = time.process_time()
            counts[n] = one.run(stream, damaged[n], one.portion)
            seconds[n][turn] = time.process_time() - start
    peaks = [
        peak_bytes(one, stream, bad) for one, stream, bad in zip(contestants, streams, damaged, strict=True)
    ]
    return [(count, some, peak) for count, some, peak in zip(counts, seconds, peaks, strict=True)]


def bench(count: int, repeats: int, seed: int) -> list[Row]:
    """Run all contestants: `count` messages for pymavlink, more for the faster decoders."""
    some = samples(np.random.default_rng(seed), 16 * count)
    seconds = len(some) * PERIOD_NS * 1e-9
    singles, eights, batches = (our_payloads(some, size) for size in (1, 8, 16))
    kinds = {
        "1 sample": (1, singles, raw_imu_stream(some[:count]), count),
        "8 samples": (8, eights, encapsulated_stream(eights[: count // 2]), count // 2),
        "16 samples": (16, batches, encapsulated_stream(batches[: count // 4]), count // 4),
    }
    rows = []
    for kind, (batch, payloads, theirs, messages) in kinds.items():
        ours = our_stream(payloads, seconds)
        few = our_stream(payloads[:messages], seconds * messages / len(payloads))
        options = {"ns_per_byte": seconds * 1e9 / len(ours), "batch": batch}
        contestants = [
            Contestant("pymavlink", run_pymavlink, theirs, messages, PORT_PORTION),
            Contestant("record", partial(run_record, **options), few, messages, PORT_PORTION),
            Contestant("decode again", partial(run_again, **options), ours, len(payloads), LOG_PORTION),
        ]
        for dirt in (0.0, 0.001, 0.01):
            results = contest(contestants, dirt, repeats, seed)
            theirs_out, theirs_took, _ = results[0]
            peer = theirs_out / statistics.median(theirs_took)
            for one, (out, rounds, peak) in zip(contestants, results, strict=True):
                took = statistics.median(rounds)
                each = tuple(
                    out / own / (theirs_out / other) for own, other in zip(rounds, theirs_took, strict=True)
                )
                rate, size, sent = out / took, len(one.clean) / one.messages, one.messages
                rows.append(
                    Row(kind, dirt, one.name, size, sent, out, rate, rate * batch, peak, rate / peer, each)
                )
    return rows


def crc_of_pymavlink() -> str:
    try:
        return f"pymavlink {version('pymavlink')} with fastcrc {version('fastcrc')}"
    except PackageNotFoundError:
        return f"pymavlink {version('pymavlink')} without fastcrc"


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--messages", type=int, default=10_000, help="messages in pymavlink's stream")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    rows = bench(given.messages, given.repeats, given.seed)
    if given.json:
        print(json.dumps([asdict(row) for row in rows], indent=1))
        return 0
    print(f"{crc_of_pymavlink()}; seed {given.seed}; median of {given.repeats}")
    print("1 sample: ImuBatch against RAW_IMU; 8, 16 samples: the same payload bytes in ENCAPSULATED_DATA")
    print(f"{'message':<11}{'bytes hit':>9}  {'decoder':<14}{'frame':>7}{'arrived':>9}", end="")
    print(f"{'M msg/s':>9}{'M samples/s':>13}{'x pymavlink':>13}{'peak MB':>9}")
    for row in rows:
        arrived = row.messages_out / row.messages_in
        print(
            f"{row.stream:<11}{row.dirt:>9.1%}  {row.decoder:<14}{row.frame_bytes:>5.0f} B{arrived:>9.1%}",
            end="",
        )
        print(f"{row.messages_per_s / 1e6:>9.3f}{row.samples_per_s / 1e6:>13.3f}", end="")
        print(f"{row.ratio:>13.1f}{row.peak_bytes / 1e6:>9.2f}")
    for row in rows:
        if row.decoder != "pymavlink":
            record_speedup(
                f"{row.decoder}, {row.stream} a message, {row.dirt:.1%} damaged: pymavlink", row.ratios
            )
    for kind in dict.fromkeys(row.stream for row in rows):
        some = [row for row in rows if row.stream == kind and row.decoder == "decode again"]
        words = ", ".join(f"{row.ratio:.1f} with {row.dirt:.1%} of the bytes hit" for row in some)
        print(f"decode again, {kind} a message, times pymavlink: {words}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
