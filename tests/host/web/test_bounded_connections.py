"""Idle and slow connections are closed when the limit is reached, so that other visitors are served."""

import errno
import http.client
import resource
import socket
import subprocess
import sys
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

import wanted
from hubodo.ingest.live.metrics_server import MetricsServer
from hubodo.listening import descriptors, listener
from hubodo.listening.listener import ADMISSION_TIMEOUT_S, MAX_ACCEPT_BATCH, BoundedListener
from hubodo.web.address import Address
from hubodo.web.app import make_app
from hubodo.web.config import Site
from hubodo.web.library import RecordingLibrary
from hubodo.web.server import serve_in_thread
from waiting import until

N_IDLE, CAPACITY, SERVER_DESCRIPTORS = 300, 16, 4


@pytest.fixture(autouse=True)
def small_capacity(monkeypatch):
    monkeypatch.setattr(listener, "connection_capacity", lambda: CAPACITY)


@contextmanager
def page(tmp_path, **site):
    own_site = Site(Address("127.0.0.1", 0), **site)
    with serve_in_thread(make_app(own_site, RecordingLibrary(tmp_path)), own_site) as port:
        yield port, "/api/recordings"


@contextmanager
def metrics(tmp_path):
    with MetricsServer("127.0.0.1:0", lambda: 0) as server:
        yield server.port, "/healthz"


def get(port, path, **headers):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    answer.read()
    return connection, answer.status


def count_descriptors():
    return len(list(Path("/proc/self/fd").iterdir()))


@pytest.mark.parametrize("server", [page, metrics])
def test_of_three_hundred_idle_connections_most_are_closed_and_a_visitor_is_served(tmp_path, server):
    with server(tmp_path) as (port, path), ExitStack() as stack:
        before = count_descriptors()
        for _ in range(N_IDLE):
            stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=60))
        assert get(port, path)[1] in (200, 503)
        until(lambda: count_descriptors() - before - N_IDLE <= CAPACITY + SERVER_DESCRIPTORS)


def test_requests_sent_byte_by_byte_do_not_block_a_visitor(tmp_path):
    with page(tmp_path) as (port, path), ExitStack() as stack:
        slow = [stack.enter_context(socket.create_connection(("127.0.0.1", port))) for _ in range(100)]
        for text in (b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX: ", b"a", b"a"):
            for connection in slow:
                try:
                    connection.sendall(text)
                except OSError:
                    continue
            assert get(port, path)[1] == 200


def test_connections_waiting_in_the_tls_handshake_are_closed_too(tmp_path):
    cert, key = tmp_path / "cert.pem", tmp_path / "key.pem"
    command = [
        wanted.program("openssl"),
        "req",
        "-x509",
        "-newkey",
        "ec",
        "-pkeyopt",
        "ec_paramgen_curve:P-256",
    ]
    command += ["-nodes", "-days", "2", "-subj", "/CN=x", "-keyout", str(key), "-out", str(cert)]
    subprocess.run(command, check=True, capture_output=True)
    key.chmod(0o600)
    with page(tmp_path, cert=cert, key=key) as (port, _), ExitStack() as stack:
        before = count_descriptors()
        for _ in range(N_IDLE):
            stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=60))
        until(lambda: count_descriptors() - before - N_IDLE <= CAPACITY + SERVER_DESCRIPTORS)


def test_an_answered_connection_stays_open_when_others_are_closed(tmp_path):
    with page(tmp_path) as (port, path), ExitStack() as stack:
        connection, _ = get(port, path)
        for _ in range(2 * CAPACITY):
            stack.enter_context(socket.create_connection(("127.0.0.1", port)))
        connection.request("GET", path)
        assert connection.getresponse().status == 200


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


@pytest.fixture
def listener_and_visitors():
    clock = Clock()
    bounded_listener = BoundedListener.listen_on("127.0.0.1", 0, capacity=4, clock=clock)
    bounded_listener.setblocking(False)
    with ExitStack() as stack:
        yield (
            bounded_listener,
            clock,
            lambda host="127.0.0.1": stack.enter_context(open_connection(bounded_listener, host)),
        )
    bounded_listener.close()


def open_connection(bounded_listener, host):
    return socket.create_connection(bounded_listener.getsockname(), source_address=(host, 0), timeout=60)


def is_closed(visitor):
    """Return True if the server has closed the connection."""
    visitor.settimeout(0.05)
    try:
        return visitor.recv(1) == b""
    except TimeoutError:
        return False
    except ConnectionResetError:
        return True


def accepted(bounded_listener, visitors):
    """Return the connections that the listener accepts from these visitors."""
    connections = []
    until(
        lambda: (
            connections.extend(filter(None, [_accept_one(bounded_listener)]))
            or len(connections) == len(visitors)
        )
    )
    return connections


def _accept_one(bounded_listener):
    try:
        return bounded_listener.accept()[0]
    except BlockingIOError:
        return None


def test_the_oldest_connection_of_the_host_with_most_pending_ones_is_closed_for_a_new_one(
    listener_and_visitors,
):
    bounded_listener, _, visitor = listener_and_visitors
    owner = visitor("127.0.0.2")
    flood = [visitor() for _ in range(5)]
    connections = accepted(bounded_listener, [owner, *flood])
    assert [is_closed(one) for one in [owner, *flood]] == [False, True, True, False, False, False]
    for connection in connections:
        connection.close()


def test_a_new_connection_is_closed_if_every_open_one_is_admitted(listener_and_visitors):
    bounded_listener, _, visitor = listener_and_visitors
    visitors = [visitor() for _ in range(4)]
    connections = accepted(bounded_listener, visitors)
    for one in visitors:
        bounded_listener.admit(one.getsockname())
    refused = visitor()
    until(lambda: _accept_one(bounded_listener) is None and is_closed(refused))
    assert not any(map(is_closed, visitors))
    connections.pop().close()
    late = visitor()
    accepted(bounded_listener, [late])[0].close()
    for connection in connections:
        connection.close()


def test_a_connection_that_is_not_admitted_in_time_is_closed(listener_and_visitors):
    bounded_listener, clock, visitor = listener_and_visitors
    visitors = [visitor(), visitor()]
    connections = accepted(bounded_listener, visitors)
    bounded_listener.admit(visitors[0].getsockname())
    clock.now = ADMISSION_TIMEOUT_S - 1
    bounded_listener.expire()
    assert not any(map(is_closed, visitors))
    clock.now = ADMISSION_TIMEOUT_S
    bounded_listener.expire()
    assert [is_closed(one) for one in visitors] == [False, True]
    for connection in connections:
        connection.close()


def test_without_a_free_descriptor_a_pending_connection_is_closed(listener_and_visitors, monkeypatch):
    bounded_listener, _, visitor = listener_and_visitors
    first = visitor()
    connections = accepted(bounded_listener, [first])

    def full(_):
        raise OSError(errno.EMFILE, "too many open files")

    monkeypatch.setattr(socket.socket, "accept", full)
    with pytest.raises(BlockingIOError):
        bounded_listener.accept()
    assert is_closed(first)
    # No connection is pending: the error reaches asyncio, whose loop then pauses for a second.
    with pytest.raises(OSError, match="too many"):
        bounded_listener.accept()
    connections[0].close()


def test_the_soft_limit_of_descriptors_is_raised_and_divided():
    program = (
        "import resource; from hubodo.listening.descriptors import *; "
        "resource.setrlimit(resource.RLIMIT_NOFILE, (256, {hard})); raise_descriptor_limit(); "
        "print(resource.getrlimit(resource.RLIMIT_NOFILE)[0], connection_capacity())"
    )
    limits = {}
    for hard in (256, 2000, 8000):
        if hard <= resource.getrlimit(resource.RLIMIT_NOFILE)[1]:
            run = [sys.executable, "-c", program.format(hard=hard)]
            limits[hard] = subprocess.run(run, capture_output=True, text=True, check=True).stdout.split()
    assert {hard: (int(soft), int(share)) for hard, (soft, share) in limits.items()}.items() <= {
        256: (256, 32),
        2000: (2000, 128),
        8000: (descriptors.WANTED_DESCRIPTORS, 128),
    }.items()
    assert MAX_ACCEPT_BATCH + 128 < 1024 // 4, (
        "two servers leave most of the usual 1024 descriptors to the recording"
    )
