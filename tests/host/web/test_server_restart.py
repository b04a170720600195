"""A server that fails is restarted, and the reason is reported."""

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
    """Let the loop of a server end twice, with and without an error, before it serves."""
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
    """Return the status of the first answer; a server that ends resets its connections."""
    while True:
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
        with closing(connection), suppress(ConnectionError):
            connection.request("GET", path)
            return connection.getresponse().status


def test_the_metrics_server_restarts_and_each_error_is_reported_once(failing_twice):
    with MetricsServer("127.0.0.1:0", lambda: 0) as server:
        until(lambda: len(server._faults._errors) == 2)
        assert status(server.port, "/healthz") == 503, "starting"
        for reason in ("no loop", "without an error"):
            with pytest.raises(ServerEnded, match=reason):
                server.show(None)
        server.show(None)


def test_the_page_server_restarts_and_each_error_is_reported_once(tmp_path, failing_twice):
    place, faults = Site(Address("127.0.0.1", 0)), ServerFaults()
    live = LivePage(lambda frame: None, server=faults)
    with serve_in_thread(make_app(place, RecordingLibrary(tmp_path)), place, faults) as port:
        until(lambda: len(faults._errors) == 2)
        assert status(port, "/api/recordings") == 200
        for _ in range(2):
            with pytest.raises(ServerEnded):
                live.show(None)
        live.show(None)
