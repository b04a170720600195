"""Nodes and senders on a port without keys are limited in number, and known ones lose nothing."""

import gc
import random
import tracemalloc
from dataclasses import replace

from faults.line import HELLO, Line, Node
from hubodo.ingest.link.link import Chunk
from hubodo.ingest.node.naming import assign_name, unique_name
from hubodo.ingest.node.request_encoder import identification_request
from hubodo.ingest.node.senders import MAX_NODES, MAX_SENDERS, SenderTable
from hubodo.recording import Event
from hubodo.units import NS_PER_S
from hubowire import FrameDecoder

LABEL = "usb0"


def stranger(number):
    return Node(replace(HELLO, serial=number.to_bytes(8, "big")))


def known_node(line):
    node = Node()
    line.receive(node.hello_frame(), sender="node 1")
    return node


def refusals(line):
    return [event for event in line.sink.events if event.kind == "refused"]


def test_of_298_nodes_on_a_udp_port_64_are_recorded_and_the_others_reported():
    line = Line(datagrams=True)
    node = known_node(line)
    for k in range(297):
        line.receive(stranger(k).hello_frame(), sender=f"10.0.0.{k} 5", seconds=0.001)
        line.receive(node.batch(), sender="node 1", seconds=0.02)
    assert len(line.recorder.nodes) == MAX_NODES == 64
    assert line.link().senders.frames_refused == 298 - 64
    (event,) = refusals(line)
    assert "--key-file" in event.text and event in line.recorder.notices
    line.wait(11)
    assert refusals(line)[-1].data["frames_refused"] == 298 - 64
    assert len(refusals(line)) == 2, "said at once, then every ten seconds at most"
    numbers = line.close().numbers()
    assert numbers == [k % 1000 for k in range(297 * 8)], "the known node loses nothing"


def test_twelve_thousand_addresses_use_no_memory_and_lose_nothing_of_the_known_node():
    line = Line(datagrams=True)
    node, noise = known_node(line), stranger(1)
    frame = noise.batch()

    def flood(first, last):
        for k in range(first, last):
            line.recorder.handle(Chunk(LABEL, line.now, frame, f"127.{k >> 8}.{k & 255}.1 5"))
            if k % 50 == 0:
                line.receive(node.batch(), sender="node 1", seconds=0.02)
            line.sink.raws.clear()

    flood(0, 1000)
    gc.collect()
    tracemalloc.start()
    flood(1000, 12_000)
    gc.collect()
    grown, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert grown < 1_500_000, "the samples of the known node among them"
    assert line.link().senders.senders_evicted > 11_000
    assert line.close().numbers() == [k % 1000 for k in range(240 * 8)]


def test_a_sender_without_hello_queues_a_bounded_number_of_frames():
    line = Line(datagrams=True)
    noise = stranger(1)
    for _ in range(5000):
        line.receive(noise.batch(), sender="evil 1", seconds=0.0)
    line.receive(noise.hello_frame(), sender="evil 1", seconds=1.0)
    assert 0 < len(line.close().numbers()) // 8 <= 2048


def test_a_node_that_comes_after_sixteen_senders_has_a_topic_of_its_own_from_its_hello_on():
    line = Line(datagrams=True)
    for k in range(20):
        line.receive(stranger(k).batch(), sender=f"evil {k}")
    nodes = [stranger(100 + k) for k in range(3)]
    for k, node in enumerate(nodes):
        line.receive(node.hello_frame() + node.batch(), sender=f"node {k}")
    topics = {label for label, _ in line.sink.raws}
    assert topics == {LABEL, *(f"{LABEL}/{k}" for k in range(2, 20))}
    assert [label for label, _ in line.sink.raws[-2:]] == [f"{LABEL}/19"] * 2


def test_frames_before_a_hello_wait_for_it_and_the_sender_is_asked_twice_a_second():
    asked = []
    line = Line(datagrams=True)
    line.recorder._send = lambda label, data, to: asked.append(to) or True
    node = stranger(1)
    for _ in range(50):
        line.receive(node.batch(), sender="node 1", seconds=0.02)
    assert asked == ["node 1"] * 2
    line.receive(node.hello_frame(), sender="node 1", seconds=1.0)
    assert line.close().numbers() == [k % 1000 for k in range(400)]


def test_senders_identified_by_a_serial_that_many_claim_are_bounded_too():
    table, node = SenderTable(datagrams=True), stranger(1)
    (hello,) = FrameDecoder().feed(node.hello_frame())
    for k in range(5 * MAX_SENDERS):
        assert table.route((hello, k, None), f"evil {k}").board == 0
    assert not table.is_identified("evil 0", 1) and table.is_identified(f"evil {5 * MAX_SENDERS - 1}", 1)
    assert table.address(1, 0) == f"evil {5 * MAX_SENDERS - 1}"


def test_a_line_has_64_nodes_at_most_too():
    line, rng = Line(), random.Random(1)
    ids = list(range(1, 250))
    rng.shuffle(ids)
    for node_id in ids:
        line.receive(Node(node_id=node_id).hello_frame(), seconds=0.01)
    assert len(line.recorder.nodes) == MAX_NODES
    assert line.link().senders.frames_refused == len(ids) - MAX_NODES


def test_the_request_for_a_hello_is_cached_and_has_no_byte_that_stops_a_board():
    """A flood of unknown senders needs it each time, and its encoding tries dozens of sequence numbers."""
    for node_id in (0, 1, 3, 255):
        request = identification_request(node_id)
        assert identification_request(node_id) is request and b"\x03" not in request


def test_there_is_always_a_free_name():
    used = {"left", *(f"left_{k}" for k in range(2, 400))}
    assert assign_name(None, 1, used) == ("left_400", True)
    assert unique_name("a", {"a"}) == "a_2" and unique_name("a", {}) == "a"


def test_a_refusal_is_an_event_of_the_log_with_its_counts():
    line = Line(datagrams=True)
    for k in range(70):
        line.receive(stranger(k).hello_frame(), sender=f"evil {k}", seconds=0.001)
    line.now += NS_PER_S
    line.recorder.tick(line.now)
    event = refusals(line)[0]
    assert isinstance(event, Event) and event.data["frames_refused"] >= 1 and event.source == LABEL
