"""Sealed datagrams are accepted only if authenticated, only once, and only in the present session."""

import hashlib
import os
import random

import pytest

from fakes.sealed_node import SealedNode, tag
from hubodo.errors import ConfigError, InputError
from hubodo.ingest.link.keys import KeyRing
from hubodo.ingest.link.ports import attach_keys, parse_port
from hubodo.ingest.link.sealed import DatagramSealer, OpenedDatagram

SERIALS = ("e661410300000001", "e661410300000002")
NOTHING = OpenedDatagram()


@pytest.fixture
def ring(tmp_path):
    ring = KeyRing(tmp_path / "keys.toml", create=True)
    for serial in SERIALS:
        ring.get_or_create_key(serial)
    return KeyRing(tmp_path / "keys.toml")


def meet(sealer, node, address="here 1"):
    """Run the handshake; return the datagrams sent by the node."""
    opening = node.opening()
    proof = node.proof(sealer.open(opening, address).answer)
    assert node.open(sealer.open(proof, address).answer) == b""
    return [opening, proof]


def met(ring, serial=SERIALS[0]):
    sealer, node = DatagramSealer(ring), SealedNode(ring.keys[serial])
    meet(sealer, node)
    return sealer, node


def test_a_sealed_datagram_is_opened_with_its_serial_and_answered_to_its_address(ring):
    sealer, node = met(ring, SERIALS[1])
    assert sealer.seal(b"first\0", SERIALS[1]) is None, "a session begins when the node uses it"
    opened = sealer.open(node.seal(b"frame\0"), "there 2")
    assert (opened.frames, opened.serial) == (b"frame\0", SERIALS[1])
    datagram, address = sealer.seal(b"order\0", SERIALS[1])
    assert address == "there 2"
    assert node.open(datagram) == b"order\0"
    assert sealer.seal(b"order\0", SERIALS[0]) is None
    assert not sealer.refused


@pytest.mark.parametrize("at", [1, 5, 9, 12, -1])
def test_a_datagram_with_a_changed_bit_is_refused(ring, at):
    sealer, node = met(ring)
    datagram = bytearray(node.seal(b"frame\0"))
    datagram[at] ^= 0x10
    assert sealer.open(bytes(datagram), "here 1").frames == b""
    assert sealer.refused.total() == 1


@pytest.mark.parametrize("at", range(34))
def test_a_handshake_of_which_a_bit_is_changed_begins_no_session(ring, at):
    sealer, node = DatagramSealer(ring), SealedNode(ring.keys[SERIALS[0]])

    def changed(data):
        data = bytearray(data)
        data[at % len(data)] ^= 0x10
        return bytes(data)

    assert sealer.open(changed(node.opening()), "here 1") == NOTHING
    answer = sealer.open(node.opening(), "here 1").answer
    assert node.proof(changed(answer)) is None
    assert sealer.open(changed(node.proof(answer)), "here 1") == NOTHING
    assert sealer.refused.total() == 2 and not sealer._sessions


def test_each_number_is_accepted_once_in_any_order(ring):
    sealer, node = met(ring)
    sent = [node.seal(b"%d\0" % k) for k in range(100)]
    order = [*range(50), 52, 51, 50, 55, *range(56, 100)]
    assert [sealer.open(sent[k], "here 1").frames for k in order] == [b"%d\0" % k for k in order]
    assert all(not sealer.open(sent[k], "here 1").frames for k in (99, 52, 3))
    assert sealer.open(sent[53], "here 1").frames == b"53\0", "late, not again"
    assert sealer.refused == {"sent again": 3}


def test_datagrams_of_an_earlier_session_are_refused(ring):
    sealer, node = DatagramSealer(ring), SealedNode(ring.keys[SERIALS[0]])
    old = [*meet(sealer, node), node.seal(b"a\0"), node.seal(b"b\0")]
    assert sealer.open(old[2], "here 1").frames
    again = SealedNode(node.key)
    meet(sealer, again)
    assert sealer.open(again.seal(b"c\0"), "here 1").frames
    assert [sealer.open(data, "evil 9").frames for data in old] == [b""] * 4
    assert sealer.open(again.seal(b"d\0"), "here 1").frames, "what is sent again ends no session"
    assert sealer.seal(b"order\0", SERIALS[0])[1] == "here 1"
    restarted = DatagramSealer(ring)
    assert restarted.open(again.seal(b"e\0"), "here 1") == NOTHING
    assert restarted.open(old[1], "here 1") == NOTHING
    assert restarted.refused == {"of no session": 2}


def test_the_earlier_session_is_valid_until_the_node_uses_the_next(ring):
    sealer, node = met(ring)
    assert sealer.open(node.seal(b"a\0"), "here 1").frames
    acknowledgement = sealer.open(node.proof(sealer.open(node.opening(), "here 1").answer), "here 1").answer
    assert sealer.open(node.seal(b"b\0"), "here 1").frames == b"b\0", "on its way before the next is known"
    assert node.open(sealer.seal(b"order\0", SERIALS[0])[0]) == b"order\0"
    assert node.open(acknowledgement) == b""
    assert sealer.open(node.seal(b"c\0"), "here 1").frames == b"c\0"
    assert len(sealer._sessions) == 1 and not sealer.refused


def test_thousands_of_forged_or_replayed_handshakes_store_nothing_and_keep_no_node_out(ring):
    """Hundreds of them arrive between any two datagrams of a handshake."""
    sealer, node, rng = DatagramSealer(ring), SealedNode(ring.keys[SERIALS[0]]), random.Random(1)
    recorded = [node.opening()]
    for _ in range(3):
        recorded += meet(sealer, node)
        recorded.append(node.seal(b"old\0"))
        sealer.open(recorded[-1], "here 1")
    sizes = [len(data) for data in recorded]

    def flood():
        for _ in range(150):
            sealer.open(rng.choice(recorded), "evil 9")
            sealer.open(b"\xfe\x21" + rng.randbytes(16), "evil 9")
            sealer.open(b"\xfe\x23" + rng.randbytes(32), "evil 9")
            sealer.open(recorded[0][:2] + rng.randbytes(sizes[0] - 2), "evil 9")

    flood()
    assert sealer.open(node.seal(b"live\0"), "here 1").frames == b"live\0"
    again = SealedNode(node.key)
    flood()
    answer = sealer.open(again.opening(), "here 1").answer
    flood()
    acknowledgement = sealer.open(again.proof(answer), "here 1").answer
    flood()
    assert sealer.open(node.seal(b"live\0"), "here 1").frames == b"live\0"
    assert again.open(acknowledgement) == b""
    flood()
    assert sealer.open(again.seal(b"new\0"), "here 1").frames == b"new\0"
    assert len(sealer._sessions) == 1
    assert sealer.seal(b"order\0", SERIALS[0])[1] == "here 1"


def test_no_plain_text_links_two_sessions_of_a_board(ring):
    """No four bytes of both sides occur in two sessions, at different times."""
    sent_bytes = []
    for now_ns in (0x1112131415161718, 0x2122232425262728):
        sealer = DatagramSealer(ring, now_ns=lambda now_ns=now_ns: now_ns)
        node = SealedNode(ring.keys[SERIALS[0]])
        sent = [node.opening()]
        sent.append(sealer.open(sent[0], "here 1").answer)
        sent.append(node.proof(sent[1]))
        sent.append(sealer.open(sent[2], "here 1").answer)
        node.open(sent[3])
        sent.append(node.seal(b""))
        words = {data[at : at + 4] for data in sent for at in range(len(data) - 3)}
        sent_bytes.append({word for word in words if len(set(word)) > 2})
    assert not sent_bytes[0] & sent_bytes[1]


def test_a_node_with_the_first_handshake_is_refused_with_a_remedy(ring):
    sealer = DatagramSealer(ring)
    ident = hashlib.sha256(b"hubodo key" + ring.keys[SERIALS[1]]).digest()[:4]
    assert sealer.open(b"\xfe" + ident + os.urandom(8), "here 1") == NOTHING
    assert sealer.refused == {f"of the older handshake of node {SERIALS[1]}: flash it again": 1}


def test_senders_without_a_key_are_refused_with_the_cause(ring):
    sealer, node = met(ring)
    stranger = SealedNode(bytes(32))
    for data in (
        b"\x07\x01plain\0",
        stranger.opening(),
        node.opening()[:9],
        node.seal(b"")[:12],
        b"",
        b"\xff",
        b"\xfe",
    ):
        assert sealer.open(data, "evil 9") == NOTHING
    assert sealer.refused == {
        "without a key": 2,
        "of a key that the file does not hold": 1,
        "malformed": 4,
    }


def test_a_proof_with_a_key_of_another_board_is_refused(ring):
    sealer, node = DatagramSealer(ring), SealedNode(ring.keys[SERIALS[0]])
    proof = node.proof(sealer.open(node.opening(), "here 1").answer)
    forged = proof[:26] + tag(ring.keys[SERIALS[1]], b"proof")
    assert sealer.open(forged, "evil 9") == NOTHING
    assert sealer.refused == {"of a key that the file does not hold": 1}


def test_keys_are_readable_by_their_owner_only_and_an_invalid_file_is_named(ring, tmp_path):
    assert (ring.path.stat().st_mode & 0o777) == 0o600
    assert set(ring.keys) == set(SERIALS) and len(set(ring.keys.values())) == 2
    with pytest.raises(InputError, match="flash PORT --key-file"):
        KeyRing(tmp_path / "none.toml")
    ring.path.write_text('[keys]\ne661410300000001 = "short"\n')
    with pytest.raises(ConfigError, match="e661410300000001"):
        KeyRing(ring.path)


def test_udp_from_other_machines_requires_keys_or_an_option(ring):
    for host in ("127.0.0.1", "localhost", "[::1]"):
        assert attach_keys(parse_port(f"udp://{host}:9"), None, insecure=()).keys is None
    for host in ("0.0.0.0", "192.168.1.2", "[::]", "laptop.local"):
        with pytest.raises(InputError, match=r"--key-file.*--insecure-udp"):
            attach_keys(parse_port(f"udp://{host}:9"), None, insecure=())
        assert attach_keys(parse_port(f"udp://{host}:9"), None, insecure=("udp",)).keys is None
        assert attach_keys(parse_port(f"udp://{host}:9"), ring.path, insecure=()).keys.keys == ring.keys
    assert attach_keys(parse_port("/dev/ttyACM0"), ring.path, insecure=()).keys is None
