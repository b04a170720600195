"""Datagrams of nodes: only what a key proves comes through, once, and only in the session that stands."""

import struct

import pytest

from hubodo.errors import ConfigError, InputError
from hubodo.ingest.link.keys import KeyRing
from hubodo.ingest.link.ports import parse_port, trusted
from hubodo.ingest.link.sealed import DATA, KNOCK, Sealer, _digest, key_id

SERIALS = ("e661410300000001", "e661410300000002")


class FakeSealedNode:
    """What a node does, written from protocol/README.md."""

    def __init__(self, key, nonce=b"\1" * 8):
        self.key, self.nonce, self.session, self.count = key, nonce, None, 0

    def knock(self):
        return bytes([KNOCK]) + key_id(self.key) + self.nonce

    def welcomed(self, answer):
        nonces, tag = answer[5:21], answer[21:]
        assert answer[:5] == bytes([0xFD]) + key_id(self.key) and nonces[:8] == self.nonce
        assert tag == _digest(self.key, b"welcome", nonces)[:8]
        self.session, self.count = _digest(self.key, b"session", nonces), 0

    def seal(self, frames):
        body = struct.pack("<I", self.count) + frames
        self.count += 1
        tag = _digest(self.session, b"n", body)[:8]
        return bytes([DATA]) + key_id(self.key) + body + tag


@pytest.fixture
def ring(tmp_path):
    ring = KeyRing(tmp_path / "keys.toml", create=True)
    for serial in SERIALS:
        ring.key_of(serial)
    return KeyRing(tmp_path / "keys.toml")


def met(ring, serial=SERIALS[0]):
    sealer, node = Sealer(ring), FakeSealedNode(ring.keys[serial])
    node.welcomed(sealer.open(node.knock(), "here 1").answer)
    return sealer, node


def test_what_a_node_seals_comes_through_with_its_serial_and_answers_go_where_it_sent_from(ring):
    sealer, node = met(ring, SERIALS[1])
    assert sealer.seal(b"first\0", SERIALS[1]) is None, "a session begins when the node uses it"
    opened = sealer.open(node.seal(b"frame\0"), "there 2")
    assert (opened.frames, opened.serial) == (b"frame\0", SERIALS[1])
    datagram, address = sealer.seal(b"order\0", SERIALS[1])
    assert address == "there 2"
    assert datagram[-8:] == _digest(node.session, b"h", datagram[5:-8])[:8]
    assert sealer.seal(b"order\0", SERIALS[0]) is None
    assert not sealer.refused


@pytest.mark.parametrize("at", [1, 5, 9, 12, -1])
def test_a_datagram_of_which_a_bit_is_changed_is_refused(ring, at):
    sealer, node = met(ring)
    datagram = bytearray(node.seal(b"frame\0"))
    datagram[at] ^= 0x10
    assert sealer.open(bytes(datagram), "here 1").frames == b""
    assert sealer.refused.total() == 1


def test_numbers_count_once_and_may_overtake_each_other(ring):
    sealer, node = met(ring)
    sent = [node.seal(b"%d\0" % k) for k in range(100)]
    order = [*range(50), 52, 51, 50, 55, *range(56, 100)]
    assert [sealer.open(sent[k], "here 1").frames for k in order] == [b"%d\0" % k for k in order]
    assert all(not sealer.open(sent[k], "here 1").frames for k in (99, 52, 3))
    assert sealer.open(sent[53], "here 1").frames == b"53\0", "late, not again"
    assert sealer.refused == {"sent again": 3}


def test_nothing_of_an_earlier_session_counts_neither_knocks_nor_frames(ring):
    sealer, node = met(ring)
    old = [node.knock(), node.seal(b"a\0"), node.seal(b"b\0")]
    assert sealer.open(old[1], "here 1").frames
    again = FakeSealedNode(node.key, nonce=b"\2" * 8)
    again.welcomed(sealer.open(again.knock(), "here 1").answer)
    assert sealer.open(again.seal(b"c\0"), "here 1").frames
    assert [sealer.open(data, "evil 9").frames for data in old] == [b"", b"", b""]
    assert sealer.open(again.seal(b"d\0"), "here 1").frames, "a knock that is sent again ends no session"
    restarted = Sealer(ring)
    assert restarted.open(again.seal(b"e\0"), "here 1").frames == b""
    assert restarted.refused == {"of no session": 1}


def test_who_has_no_key_is_refused_by_cause(ring):
    sealer, node = met(ring)
    stranger = FakeSealedNode(bytes(32))
    for data in (
        b"\x07\x01plain\0",
        stranger.knock(),
        node.knock()[:9],
        bytes([DATA]) + key_id(node.key),
        b"",
    ):
        assert sealer.open(data, "evil 9") == type(sealer.open(b"", "evil 9"))()
    assert sealer.refused["of a key that the file does not hold"] == 1
    assert sealer.refused["malformed"] == 2


def test_keys_are_kept_for_their_owner_alone_and_a_wrong_file_is_named(ring, tmp_path):
    assert (ring.path.stat().st_mode & 0o777) == 0o600
    assert set(ring.keys) == set(SERIALS) and len(set(ring.keys.values())) == 2
    with pytest.raises(InputError, match="flash PORT --key-file"):
        KeyRing(tmp_path / "none.toml")
    ring.path.write_text('[keys]\ne661410300000001 = "short"\n')
    with pytest.raises(ConfigError, match="e661410300000001"):
        KeyRing(ring.path)


def test_udp_from_other_machines_wants_keys_or_a_word(ring):
    for host in ("127.0.0.1", "localhost", "[::1]"):
        assert trusted(parse_port(f"udp://{host}:9"), None, insecure=False).keys is None
    for host in ("0.0.0.0", "192.168.1.2", "[::]", "laptop.local"):
        with pytest.raises(InputError, match=r"--key-file.*--insecure-udp"):
            trusted(parse_port(f"udp://{host}:9"), None, insecure=False)
        assert trusted(parse_port(f"udp://{host}:9"), None, insecure=True).keys is None
        assert trusted(parse_port(f"udp://{host}:9"), ring.path, insecure=False).keys.keys == ring.keys
    assert trusted(parse_port("/dev/ttyACM0"), ring.path, insecure=False).keys is None
