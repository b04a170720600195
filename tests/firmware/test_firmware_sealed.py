"""HMAC-SHA256 and sessions of the node in real MicroPython, compared with CPython."""

import hmac
import json
import struct

import pytest
import real_micropython
from test_firmware_link_memory import FAKES

import hubowire
from fakes.sealed_node import SealedNode
from hubodo.ingest.link.keys import KeyRing
from hubodo.ingest.link.sealed import DatagramSealer
from hubowire import messages as m

# RFC 4231, section 4: (key, data, HMAC-SHA-256); keys of up to 64 bytes.
RFC_4231 = [
    (b"\x0b" * 20, b"Hi There", "b0344c61d8db38535ca8afceaf0bf12b881dc200c9833da726e9376c2e32cff7"),
    (
        b"Jefe",
        b"what do ya want for nothing?",
        "5bdcc146bf60754e6a042426089575c75a003f089d2739839dec58b964ec3843",
    ),
    (b"\xaa" * 20, b"\xdd" * 50, "773ea91e36800e46854db8ebd09181a72959098b3ef8c122d9635514ced565fe"),
    (
        bytes(range(1, 26)),
        b"\xcd" * 50,
        "82558a389a443c0ea4cc819899f2083a85f0faa3e578f8077a2e3ff46729665b",
    ),
]
KEY = bytes(range(32))

VECTORS = """
from sealed import Hmac
import binascii
result = [binascii.hexlify(Hmac(key).digest(data[:3], data[3:])).decode() for key, data in {rows}]
"""

SESSION = """
import sealed, wifi, binascii
class Pipe(Sink):
    sent, coming = [], []
    def write(self, raw, at=0, size=0):
        Pipe.sent.append(binascii.hexlify(bytes(raw[at:at + size])).decode())
        return size
    def readinto(self, buffer):
        if not Pipe.coming:
            return None
        data = Pipe.coming.pop(0)
        buffer[: len(data)] = data
        return len(data)
socket.socket = lambda family, kind: Pipe()
sealed._random = lambda: bytes(range(8))
settings = {{"ssid": "a", "password": "b", "host": "10.0.0.7", "port": 47110}}
port = sealed.SealedLink(wifi.UdpLink(settings), "{key}")
box = outbox.Outbox(4, 1)
box.post(2, 200)
port.send(box)
waits = box.count
frames = []
for data in {coming}:
    Pipe.coming.append(bytes.fromhex(data))
    while port.receive():
        frames.append([port.reader.type_id, port.reader.seq])
port.send(box)
box.post(6, 3)
port.send(box)
result = {{"sent": Pipe.sent, "waits": waits, "frames": frames, "damaged": port.reader.damaged}}
"""

WRITE = """
with open("/result", "w") as file:
    json.dump(result, file)
"""


def test_the_hmac_agrees_with_rfc_4231(tmp_path):
    rows = [(key, data) for key, data, _ in RFC_4231]
    result, _ = real_micropython.run(tmp_path, FAKES, VECTORS.format(rows=repr(rows)), WRITE)
    assert result == [expected for _, _, expected in RFC_4231]
    assert all(hmac.digest(k, d, "sha256").hex() == e for k, d, e in RFC_4231), (
        "the table agrees with hmac of Python"
    )


SERIAL = "e661410300000001"


@pytest.fixture
def host(tmp_path):
    ring = KeyRing(tmp_path / "keys.toml", create=True)
    ring.keys[SERIAL] = KEY
    return DatagramSealer(ring, random_bytes=lambda count: b"\x5a" * count, now_ns=lambda: 10**12)


def datagrams_of_a_node(tmp_path, coming):
    """Run a node that receives these datagrams; return the datagrams sent, and the result of the script."""
    text = SESSION.format(key=KEY.hex(), coming=repr([data.hex() for data in coming]))
    result, _ = real_micropython.run(tmp_path, FAKES, text, WRITE)
    return [bytes.fromhex(data) for data in result["sent"]], result


def test_before_a_session_a_node_only_sends_the_handshake_and_accepts_only_its_host(tmp_path, host):
    """Requests come sealed, plain, changed, repeated and from another session: only the first is valid.

    The messages of the host depend on the proof of the node, which a first run gives.
    """
    twin = SealedNode(KEY)
    twin.nonce = bytes(range(8))
    opening = twin.opening()
    answer = host.open(opening, "node 1").answer
    (tmp_path / "first").mkdir()
    sent, result = datagrams_of_a_node(tmp_path / "first", [answer])
    handshake = [opening, twin.proof(answer)]
    assert sent == handshake and result["waits"] == 1
    acknowledgement = host.open(sent[1], "node 1").answer
    host.open(_first_frame(twin, acknowledgement), "node 1")
    ping = b"\0" + hubowire.encode_frame(hubowire.Frame(m.Ping.type_id, 1, 77, b""))
    order, _ = host.seal(ping, SERIAL)
    changed, _ = host.seal(ping, SERIAL)
    changed = changed[:-1] + bytes([changed[-1] ^ 1])
    false_answer = answer[:-1] + bytes([answer[-1] ^ 1])
    coming = [ping, false_answer, answer, acknowledgement, order, ping, changed, order, answer]
    sent, result = datagrams_of_a_node(tmp_path, coming)
    assert result["waits"] == 1, "the frame waits until the session starts"
    assert result["frames"] == [[m.Ping.type_id, 77]]
    assert result["damaged"] == 6, "every other datagram is counted"
    assert sent[:2] == handshake and len(sent) == 4
    assert [struct.unpack_from("<I", data, 5)[0] for data in sent[2:]] == [0, 1]
    plain = [data[9:-8] for data in sent[2:]]
    types = [f.type_id for frames in plain for f in hubowire.FrameDecoder().feed(frames)]
    assert types == [2, 6]
    assert host.open(sent[3], "node 1").frames == plain[1] and not host.refused
    print(json.dumps({"bytes more than the frame": len(sent[2]) - len(plain[0])}))


def _first_frame(twin, acknowledgement):
    """Return the first datagram of a session, which makes the host use it."""
    assert twin.open(acknowledgement) == b""
    return twin.seal(b"")


def test_a_session_is_valid_until_the_host_uses_the_next_and_a_repeated_proof_starts_another(tmp_path, host):
    """The first acknowledgement is lost: the node repeats its opening with the same nonce and connects."""
    twin = SealedNode(KEY)
    twin.nonce = bytes(range(8))
    first = host.open(twin.opening(), "node 1").answer
    host.open(twin.proof(first), "node 1")
    second = host.open(twin.opening(), "node 1").answer
    acknowledgement = host.open(twin.proof(second), "node 1").answer
    sent, result = datagrams_of_a_node(tmp_path, [first, second, acknowledgement])
    assert result["damaged"] == 0 and len(sent) == 5
    opened = [host.open(data, "node 1") for data in sent[3:]]
    assert all(data.serial == SERIAL for data in opened) and not host.refused
