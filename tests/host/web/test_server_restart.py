"""A server that fails is started again, and whoever shows the recording reports why."""

import http.client
from contextlib import closing, suppress

import pytest
import uvicorn

from hubodo.ingest.live.metrics_server import MetricsServer
from hubodo.listening import server_thread
from hubodo.listening.server_thread import ServerEnded, ServerFaults
from hubodo.web.address import Address
from hubodo.web.app import make_app
from hubodo.web.config import Site
from hubodo.web.library import RecordingLibrary
from hubodo.web.live_page import LivePage
from hubodo.web.server import serve_in_thread
from waiting import until


@pytest.fixture
def failing_twice(monkeypatch):
    """The loop of a server ends twice, by an error and without one, before it serves."""
    main_loop, failures = uvicorn.Server.main_loop, iter((True, False))
    monkeypatch.setattr(server_thread, "_MIN_PAUSE_S", 0.01)

    async def fails_twice(self):
        fails = next(failures, None)
        if fails:
            raise RuntimeError("no loop")
        if fails is None:
            await main_loop(self)

    monkeypatch.setattr(uvicorn.Server, "main_loop", fails_twice)


def status(port, path):
    """The status of the first answer; a server that ends resets the connections that it has."""
    while True:
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
        with closing(connection), suppress(ConnectionError):
            connection.request("GET", path)
            return connection.getresponse().status


def test_metrics_are_served_again_and_the_errors_reported_once_each(failing_twice):
    with MetricsServer("127.0.0.1:0", lambda: 0) as server:
        until(lambda: len(server._faults._errors) == 2)
        assert status(server.port, "/healthz") == 503, "starting"
        for reason in ("no loop", "without an error"):
            with pytest.raises(ServerEnded, match=reason):
                server.show(None)
        server.show(None)


def test_the_page_is_served_again_and_the_errors_reported_once_each(tmp_path, failing_twice):
    place, faults = Site(Address("127.0.0.1", 0)), ServerFaults()
    live = LivePage(lambda frame: None, server=faults)
    with serve_in_thread(make_app(place, RecordingLibrary(tmp_path)), place, faults) as port:
        until(lambda: len(faults._errors) == 2)
        assert status(port, "/api/recordings") == 200
        for _ in range(2):
            with pytest.raises(ServerEnded):
                live.show(None)
        live.show(None)
