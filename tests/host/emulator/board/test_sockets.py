"""Network calls of an emulated board: UDP sockets behind the WLAN station, and the DNS server."""

import socket
import struct
from collections import Counter

import pytest

from hubodo.emulator.board.clock import BoardClock
from hubodo.emulator.board.hypercall import EAGAIN, EHOSTUNREACH, EINVAL, Op
from hubodo.emulator.board.models import MODELS
from hubodo.emulator.board.network import NAME_SERVER, WifiEnvironment
from hubodo.emulator.board.settings import Clock
from hubodo.emulator.board.sockets import BoardNetwork

SECOND = 1_000_000_000
ACTIVATE, CONNECT, IS_CONNECTED = 1, 2, 5


def _address(host: str, port: int) -> bytes:
    return socket.inet_aton(host) + struct.pack("<H", port)


class Board:
    """The network of a Pico W with its calls."""

    def __init__(self, **environment: object) -> None:
        self.counts: Counter[str] = Counter()
        clock = BoardClock(Clock("stepped"))
        air = WifiEnvironment(**environment)  # type: ignore[arg-type]
        self.network = BoardNetwork(MODELS["pico_w"], air, clock, self.counts)
        self.calls = self.network.handlers()

    def join_network(self) -> None:
        """Join the access point, which takes 0.3 s."""
        self.calls[Op.WLAN](ACTIVATE, b"", 0.0)
        self.calls[Op.WLAN](CONNECT, b"", 0.0)
        assert self.calls[Op.WLAN](IS_CONNECTED, b"", 1.0 * SECOND).status == 1

    def send(self, handle: int, to: tuple[str, int], data: bytes) -> int:
        return int(self.calls[Op.UDP_SEND](handle, _address(*to) + data, 1.0 * SECOND).status)

    def receive(self, handle: int, limit: int = 100) -> tuple[int, bytes]:
        """Poll once."""
        call = self.calls[Op.UDP_RECV](handle, struct.pack("<Ii", limit, 0), 1.0 * SECOND)
        reply = call.poll_reply(False)
        return reply.status, reply.payload


@pytest.fixture
def host() -> socket.socket:
    """A socket of the host."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        sock.settimeout(5.0)
        yield sock


def test_datagrams_go_both_ways_with_their_sender(host: socket.socket) -> None:
    board = Board()
    board.join_network()
    handle = board.calls[Op.UDP_OPEN](0, b"", 0.0).status
    assert board.send(handle, host.getsockname(), b"samples") == 7
    data, sender = host.recvfrom(100)
    assert data == b"samples"
    assert board.receive(handle) == (-EAGAIN, b"")
    host.sendto(b"ack", sender)
    assert board.receive(handle) == (3, _address(*host.getsockname()) + b"ack")
    assert (board.counts["bytes_out"], board.counts["bytes_in"]) == (7, 3)
    board.network.reset()


def test_a_board_that_has_not_joined_reaches_nobody(host: socket.socket) -> None:
    board = Board()
    handle = board.calls[Op.UDP_OPEN](0, b"", 0.0).status
    assert board.send(handle, host.getsockname(), b"x") == -EHOSTUNREACH
    assert not board.network.is_radio_on()
    board.network.reset()


def test_handles_are_reused_after_closing_and_a_port_is_bound_once(host: socket.socket) -> None:
    board = Board()
    first, second = (board.calls[Op.UDP_OPEN](0, b"", 0.0).status for _ in range(2))
    assert first != second
    port = struct.pack("<H", host.getsockname()[1])
    assert board.calls[Op.UDP_BIND](first, port, 0.0).status == -EINVAL
    board.calls[Op.UDP_CLOSE](first, b"", 0.0)
    assert board.calls[Op.UDP_OPEN](0, b"", 0.0).status == first
    # A handle that is not open can be closed, as after a restart.
    board.calls[Op.UDP_CLOSE](99, b"", 0.0)
    board.network.reset()


def test_a_restart_closes_the_sockets_and_leaves_the_network() -> None:
    board = Board()
    board.join_network()
    handle = board.calls[Op.UDP_OPEN](0, b"", 0.0).status
    board.network.reset()
    assert not board.network.is_radio_on()
    assert not board.network.has_datagram(handle)


def test_a_name_is_answered_by_the_server_with_the_newest_valid_address() -> None:
    board = Board(
        dns_records=(
            (0.0, "car.local", "10.0.0.7"),
            (0.5, "car.local", "10.0.0.8"),
            (9.0, "car.local", "10.0.0.9"),
        )
    )
    board.join_network()
    handle = board.calls[Op.UDP_OPEN](0, b"", 0.0).status
    query = (
        b"\x12\x34" + struct.pack(">5H", 0x0100, 1, 0, 0, 0) + b"\3car\5local\0" + struct.pack(">2H", 1, 1)
    )
    assert board.send(handle, NAME_SERVER, query) == len(query)
    assert board.network.has_datagram(handle)
    status, payload = board.receive(handle)
    assert payload[:6] == _address(*NAME_SERVER) and payload[6:8] == b"\x12\x34"
    assert payload.endswith(bytes([10, 0, 0, 8]))
    assert status == len(payload) - 6
    assert not board.network.has_datagram(handle)
    board.network.reset()
