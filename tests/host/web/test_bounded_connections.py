"""Connections that say nothing, or say it slowly: they are shed, and a visitor is answered beside them."""

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

IDLE, CAPACITY, OF_THE_SERVER = 300, 16, 4


@pytest.fixture(autouse=True)
def small(monkeypatch):
    monkeypatch.setattr(listener, "connection_capacity", lambda: CAPACITY)


@contextmanager
def page(tmp_path, **site):
    place = Site(Address("127.0.0.1", 0), **site)
    with serve_in_thread(make_app(place, RecordingLibrary(tmp_path)), place) as port:
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


def descriptors_open():
    return len(list(Path("/proc/self/fd").iterdir()))


@pytest.mark.parametrize("server", [page, metrics])
def test_three_hundred_idle_connections_are_shed_and_a_visitor_is_answered(tmp_path, server):
    with server(tmp_path) as (port, path), ExitStack() as stack:
        before = descriptors_open()
        for _ in range(IDLE):
            stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=60))
        assert get(port, path)[1] in (200, 503)
        until(lambda: descriptors_open() - before - IDLE <= CAPACITY + OF_THE_SERVER)


def test_requests_that_come_byte_by_byte_do_not_keep_a_visitor_out(tmp_path):
    with page(tmp_path) as (port, path), ExitStack() as stack:
        slow = [stack.enter_context(socket.create_connection(("127.0.0.1", port))) for _ in range(100)]
        for text in (b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX: ", b"a", b"a"):
            for connection in slow:
                try:
                    connection.sendall(text)
                except OSError:
                    continue
            assert get(port, path)[1] == 200


def test_connections_that_wait_in_the_tls_handshake_are_shed_too(tmp_path):
    cert, key = tmp_path / "cert.pem", tmp_path / "key.pem"
    words = [
        wanted.program("openssl"),
        "req",
        "-x509",
        "-newkey",
        "ec",
        "-pkeyopt",
        "ec_paramgen_curve:P-256",
    ]
    words += ["-nodes", "-days", "2", "-subj", "/CN=x", "-keyout", str(key), "-out", str(cert)]
    subprocess.run(words, check=True, capture_output=True)
    key.chmod(0o600)
    with page(tmp_path, cert=cert, key=key) as (port, _), ExitStack() as stack:
        before = descriptors_open()
        for _ in range(IDLE):
            stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=60))
        until(lambda: descriptors_open() - before - IDLE <= CAPACITY + OF_THE_SERVER)


def test_a_connection_whose_request_was_answered_is_kept_when_others_are_shed(tmp_path):
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
def bounded():
    clock = Clock()
    made = BoundedListener.listen_on("127.0.0.1", 0, capacity=4, clock=clock)
    made.setblocking(False)
    with ExitStack() as stack:
        yield made, clock, lambda host="127.0.0.1": stack.enter_context(visit(made, host))
    made.close()


def visit(made, host):
    return socket.create_connection(made.getsockname(), source_address=(host, 0), timeout=60)


def ended(visitor):
    """Whether the server has shut the connection down."""
    visitor.settimeout(0.05)
    try:
        return visitor.recv(1) == b""
    except TimeoutError:
        return False
    except ConnectionResetError:
        return True


def accepted(made, visitors):
    """The connections that the listener gives for them."""
    held = []
    until(lambda: held.extend(filter(None, [_one(made)])) or len(held) == len(visitors))
    return held


def _one(made):
    try:
        return made.accept()[0]
    except BlockingIOError:
        return None


def test_the_host_with_most_pending_connections_pays_for_a_new_one(bounded):
    made, _, visitor = bounded
    owner = visitor("127.0.0.2")
    flood = [visitor() for _ in range(5)]
    held = accepted(made, [owner, *flood])
    assert [ended(one) for one in [owner, *flood]] == [False, True, True, False, False, False]
    for connection in held:
        connection.close()


def test_where_every_connection_is_admitted_a_new_one_is_closed(bounded):
    made, _, visitor = bounded
    visitors = [visitor() for _ in range(4)]
    held = accepted(made, visitors)
    for one in visitors:
        made.admit(one.getsockname())
    refused = visitor()
    until(lambda: _one(made) is None and ended(refused))
    assert not any(map(ended, visitors))
    held.pop().close()
    late = visitor()
    accepted(made, [late])[0].close()
    for connection in held:
        connection.close()


def test_a_connection_that_was_not_admitted_in_time_is_shut_down(bounded):
    made, clock, visitor = bounded
    visitors = [visitor(), visitor()]
    held = accepted(made, visitors)
    made.admit(visitors[0].getsockname())
    clock.now = ADMISSION_TIMEOUT_S - 1
    made.expire()
    assert not any(map(ended, visitors))
    clock.now = ADMISSION_TIMEOUT_S
    made.expire()
    assert [ended(one) for one in visitors] == [False, True]
    for connection in held:
        connection.close()


def test_without_a_descriptor_left_a_pending_connection_is_shed(bounded, monkeypatch):
    made, _, visitor = bounded
    first = visitor()
    held = accepted(made, [first])

    def full(_):
        raise OSError(errno.EMFILE, "too many open files")

    monkeypatch.setattr(socket.socket, "accept", full)
    with pytest.raises(BlockingIOError):
        made.accept()
    assert ended(first)
    # Nothing is pending now: the loop of asyncio pauses for a second on this error.
    with pytest.raises(OSError, match="too many"):
        made.accept()
    held[0].close()


def test_the_soft_limit_of_descriptors_is_raised_and_shared_out():
    words = (
        "import resource; from hubodo.listening.descriptors import *; "
        "resource.setrlimit(resource.RLIMIT_NOFILE, (256, {hard})); raise_descriptor_limit(); "
        "print(resource.getrlimit(resource.RLIMIT_NOFILE)[0], connection_capacity())"
    )
    limits = {}
    for hard in (256, 2000, 8000):
        if hard <= resource.getrlimit(resource.RLIMIT_NOFILE)[1]:
            run = [sys.executable, "-c", words.format(hard=hard)]
            limits[hard] = subprocess.run(run, capture_output=True, text=True, check=True).stdout.split()
    assert {hard: (int(soft), int(share)) for hard, (soft, share) in limits.items()}.items() <= {
        256: (256, 32),
        2000: (2000, 128),
        8000: (descriptors.WANTED_DESCRIPTORS, 128),
    }.items()
    assert MAX_ACCEPT_BATCH + 128 < 1024 // 4, "two servers leave most of the usual 1024 to the recording"
