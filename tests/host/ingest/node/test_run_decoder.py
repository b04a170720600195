"""Decoding many frames at once gives the samples, events and counters of decoding one by one."""

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hubodo.ingest.node.bulk import BulkDecoder
from hubodo.ingest.node.decoder import NodeDecoder
from hubodo.ingest.node.gaps import GapGroup, LinkCounts
from hubodo.ingest.node.log_times import LogTimeSequence
from hubodo.ingest.node.node_frames import group_by_node
from hubodo.ingest.node.outputs import BiasFilterReport
from hubodo.ingest.node.run_decoder import RunDecoder
from hubodo.log.records import ImuBlock, ImuRun
from hubodo.recording import Event
from hubodo.units import NS_PER_S
from hubowire import FINGERPRINT, Frame, encode, encode_frame
from hubowire.messages import BatchFlag, Filter, Health, Hello, ImuBatch, Mag, TimeReply
from repetitions import first_and_more

T0 = 1_700_000_000 * NS_PER_S
PERIOD_NS = 4_807_692
HELLO = Hello(
    FINGERPRINT, (1, 2, 3), b"serial01", 77, 1, 1, 208_000, 2000, 16,
    70_000_000, 488_000, 62_500, 25_000_000, 14_614_000, 8, 0, 40, ((0x6B, 0x69, 1),),
)  # fmt: skip


class Node:
    """A node with faults of itself and its link; each frame with its time of arrival."""

    def __init__(self, rng, node_id):
        self.rng, self.node_id, self.hello = rng, node_id, replace(HELLO, boot_id=int(rng.integers(1, 99)))
        self.seqs, self.index, self.us, self.t_ns = {}, 0, int(rng.integers(0, 1 << 30)), T0
        self.damaged, self.dropped = 0, 0
        self.came = []  # (frame, host time, damaged pieces before it)

    def send(self, message, *, lost=False, payload=None):
        seq = self.seqs.get(message.type_id, int(self.rng.integers(0, 65536)))
        self.seqs[message.type_id] = (seq + 1) & 0xFFFF
        if not lost:
            body = encode(message) if payload is None else payload
            frame = Frame(message.type_id, self.node_id, seq, body)
            self.came.append((frame, self.t_ns, self.damaged))

    def pass_time(self, us):
        self.us += us
        self.t_ns += us * 1000 + int(self.rng.integers(-300_000, 300_000))

    def batch(self, *, lost=False, flags=0, period=PERIOD_NS, count=None, newer=b""):
        count = int(self.rng.integers(1, 20)) if count is None else count
        rows = tuple(map(tuple, self.rng.integers(-32768, 32768, (count, 6)).tolist()))
        raw = int(self.rng.integers(-3000, 3000))
        message = ImuBatch(self.us % (1 << 30), period, self.index & 0xFFFF, raw, flags, rows)
        self.send(message, lost=lost, payload=encode(message) + newer if newer else None)
        self.index += count
        self.pass_time(count * PERIOD_NS // 1000)

    def act(self, kind):
        now = self.us % (1 << 30)
        match kind:
            case "batches":
                size = int(self.rng.integers(1, 20)) if self.rng.random() < 0.7 else None
                for _ in range(int(self.rng.integers(1, 12))):
                    self.batch(count=size)
            case "lost":
                self.batch(lost=True)
            case "damaged":
                self.batch(lost=True)
                self.damaged += 1
            case "overrun":
                self.index += int(self.rng.integers(0, 40))
                self.pass_time(int(self.rng.integers(0, 200_000)))
                self.batch(flags=BatchFlag.FIFO_OVERRUN | BatchFlag.SATURATED)
            case "odd":
                self.batch(period=0)
                self.batch(newer=b"newer"[: max(0, 5)], count=3)
                self.send(ImuBatch(now, PERIOD_NS, self.index & 0xFFFF, 0, 0, ()))
                cut = encode(ImuBatch(now, PERIOD_NS, self.index & 0xFFFF, 0, 0, ((1,) * 6,) * 2))
                self.send(ImuBatch(now, PERIOD_NS, 0, 0, 0, ()), payload=cut[:30])
                self.send(ImuBatch(now, PERIOD_NS, 0, 0, 0, ()), payload=cut[:9])
            case "saturated":
                self.batch(flags=BatchFlag.SATURATED)
            case "small":
                self.send(Mag(now, (1, -2, 3)))
                self.send(Filter(now, 2, 0, 2000, (1, 2, 3), (4, 5, 6), (7, 8, 9), (10, 11, 12)))
                self.send(TimeReply(b"12345678", now, (now + 70) % (1 << 30)))
            case "dropped":
                self.batch(lost=True)
                self.dropped += 1
                self.health()
            case "health":
                self.health()
            case "hello":
                self.send(self.hello)
            case "pause":
                self.pass_time(int(self.rng.integers(1, 1500)) * 1_000_000)
            case "jump":
                self.us += int(self.rng.integers(2, 400)) * 1_000_000
            case "restart":
                self.hello = replace(self.hello, boot_id=self.hello.boot_id + 1, gyro_lsb_ndps=35_000_000)
                self.seqs, self.index, self.us, self.dropped = {}, 0, 1_000_000, 0
                self.pass_time(300_000)
                if self.rng.random() < 0.5:
                    self.batch(count=4)
                self.send(self.hello)
            case "strange":
                self.came.append((Frame(0x3F, self.node_id, 1, b"?"), self.t_ns, self.damaged))

    def health(self):
        now = self.us % (1 << 30)
        self.send(Health(now, 3700, 0, 0, 0, 0, 0, self.dropped, 0, 1, 900, 1, 50_000, 40))


ACTIONS = ("batches", "lost", "damaged", "overrun", "odd", "saturated", "small", "dropped", "health")
ACTIONS += ("hello", "pause", "jump", "restart", "strange")


def arrival(table):
    ends = np.array([row[0] for row in table], np.int64)
    arrivals = np.array([row[1:] for row in table], np.int64).reshape(-1, 2)

    def at(end):
        rows = np.searchsorted(ends, end)
        assert (ends[rows] == end).all()
        return arrivals[rows, 0], arrivals[rows, 1]

    return at


def one_by_one(outputs):
    """Return blocks and events one by one, gaps last, because those of a run follow its blocks."""
    flat = []
    for item in outputs:
        match item:
            case ImuRun():
                flat += item.split()
            case GapGroup():
                flat += item.to_events()
            case _:
                flat.append(item)
    gaps = [item for item in flat if isinstance(item, Event) and item.kind == "gap"]
    return [item for item in flat if not isinstance(item, Event) or item.kind != "gap"] + gaps


def same(a, b):
    assert type(a) is type(b)
    if not isinstance(a, ImuBlock | BiasFilterReport):
        return a == b
    pairs = [(getattr(a, item.name), getattr(b, item.name)) for item in fields(a)]
    return all(np.array_equal(x, y) and np.asarray(x).dtype == np.asarray(y).dtype for x, y in pairs)


def check(came, portions, *, datagrams=False, downs=2):
    """Compare both decoders; return the number of runs and their share of the samples."""
    single, many, bulk = (
        NodeDecoder("left", datagrams=datagrams),
        RunDecoder("left", datagrams=datagrams),
        BulkDecoder(),
    )
    runs = together = at = end = 0
    for size in portions:
        part = came[at : at + size]
        at += size
        expected = [
            item for frame, t, n in part for item in single.decode_frame(frame, t, LinkCounts(n, downs))
        ]
        table, stream = [], b""
        for frame, t, n in part:
            stream += encode_frame(frame)
            table.append((end + len(stream), t, n))
        end += len(stream)
        frames = group_by_node(bulk.feed(stream), arrival(table))
        outputs = [item for some in frames.values() for item in many.decode_many(some, downs)]
        sizes = [len(item.device_ns) for item in outputs if isinstance(item, ImuRun)]
        runs, together = runs + len(sizes), together + sum(sizes)
        flat, expected = one_by_one(outputs), one_by_one(expected)
        assert len(flat) == len(expected)
        assert all(same(a, b) for a, b in zip(flat, expected, strict=True))
        assert many.counts == single.counts
        assert (many.hello, many.mismatch_text, many.wants_hello) == (
            single.hello,
            single.mismatch_text,
            single.wants_hello,
        )
    assert list(many.close()) == list(single.close())
    return runs, together / max(many.counts.samples, 1)


@settings(max_examples=150)
@given(
    st.integers(0, 2**32 - 1),
    st.lists(st.sampled_from(ACTIONS), max_size=40),
    st.lists(st.integers(1, 60), min_size=1, max_size=20),
    st.booleans(),
)
def test_bulk_decoding_equals_decoding_one_by_one(seed, actions, sizes, datagrams):
    node = Node(np.random.default_rng(seed), 1)
    if seed % 3:
        node.send(node.hello)
    for kind in actions:
        node.act(kind)
    sizes = [*sizes, len(node.came)]
    check(node.came, sizes, datagrams=datagrams)


@pytest.mark.parametrize("seed", first_and_more(0, 1, 2, 3))
def test_a_long_recording_with_all_that_happens_is_the_same_and_mostly_runs(seed):
    print(f"seed {seed}")
    rng = np.random.default_rng(seed)
    node = Node(rng, 1)
    node.send(node.hello)
    for _ in range(200):
        for _ in range(6):
            node.act("batches")
        node.act(str(rng.choice(ACTIONS)))
        node.act("hello")
    assert len(node.came) > 5_000
    _, together = check(node.came, [3000] * (len(node.came) // 3000 + 1))
    print(f"{together:.1%} of the samples in runs")
    assert together > 0.75


@pytest.mark.parametrize("lost", [1, 2, 7])
def test_lost_frames_do_not_end_a_run(lost):
    """Send three batches, then ten single ones with frames missing before each."""
    node = Node(np.random.default_rng(lost), 1)
    node.send(node.hello)
    for _ in range(3):
        node.batch(count=8)
    for _ in range(10):
        for _ in range(lost):
            node.batch(count=8, lost=True)
        node.batch(count=8)
    runs, together = check(node.came, [len(node.came)])
    assert runs == 1 and together > 0.8


def test_frames_of_two_nodes_are_separated():
    nodes = [Node(np.random.default_rng(k), k) for k in (1, 2)]
    stream, table = b"", []
    for node in nodes:
        node.send(node.hello)
        for _ in range(5):
            node.act("batches")
    for (a, t, n), (b, u, m) in zip(nodes[0].came, nodes[1].came, strict=False):
        for frame, *arrivals in ((a, t, n), (b, u, m)):
            stream += encode_frame(frame)
            table.append((len(stream), *arrivals))
    frames = group_by_node(BulkDecoder().feed(stream), arrival(table))
    assert set(frames) == {1, 2}
    for number, some in frames.items():
        sent = [row for row in nodes[number - 1].came if row[0].type_id == ImuBatch.type_id]
        assert [some.batch_frame(k) for k in range(len(some.batches))] == [
            frame for frame, *_ in sent[: len(some.batches)]
        ]


@given(st.lists(st.lists(st.integers(0, 50), min_size=1, max_size=8), max_size=6))
def test_bulk_log_times_equal_those_one_by_one(received):
    single, many = LogTimeSequence(), LogTimeSequence()
    for times in received:
        assert many.next_times(np.array(times, np.int64)).tolist() == [single.next_time(t) for t in times]
