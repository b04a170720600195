"""`/metrics` and `/healthz` over HTTP, from a thread of their own, for a recording without the live page."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from types import TracebackType
from typing import Any, Self
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer, make_server

from prometheus_client.exposition import ThreadingWSGIServer

from hubodo.errors import InputError
from hubodo.ingest.live.metrics import CONTENT_TYPE, health, metrics_text
from hubodo.ingest.live.snapshot import Snapshot

StartResponse = Callable[[str, list[tuple[str, str]]], Any]


class _Handler(WSGIRequestHandler):
    timeout = 5.0
    """s; a peer that says nothing does not keep a thread for ever."""

    def log_message(self, format: str, *args: object) -> None:
        """Requests are no news of a recording."""


class MetricsServer:
    """Serves the newest snapshot that it was given; a context manager.

    address: HOST:PORT, port 0 for any that is free. now_ns: host time. Raises InputError where the address
    is none or is taken.
    """

    def __init__(self, address: str, now_ns: Callable[[], int]) -> None:
        host, colon, port = address.rpartition(":")
        if not colon or not port.isdigit() or int(port) > 65535:
            raise InputError(f"metrics address {address!r}: write HOST:PORT, such as 127.0.0.1:9464")
        self._now_ns = now_ns
        self._newest: Snapshot | None = None
        try:
            self._server: WSGIServer = make_server(
                host.strip("[]"), int(port), self._app, ThreadingWSGIServer, _Handler
            )
        except OSError as error:
            raise InputError(
                f"metrics address {address}: {error.strerror or error}; choose another port, or close "
                "the program that has it"
            ) from None
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True, name="metrics")

    @property
    def port(self) -> int:
        """That it listens on."""
        return int(self._server.server_port)

    def show(self, snapshot: Snapshot) -> None:
        """From now on this is served."""
        self._newest = snapshot

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.shutdown()
        self._server.server_close()

    def _app(self, request: dict[str, Any], start: StartResponse) -> Iterable[bytes]:
        status, kind, body = answer(str(request.get("PATH_INFO", "")), self._newest, self._now_ns())
        start(status, [("Content-Type", kind), ("Content-Length", str(len(body)))])
        return [body]


def answer(path: str, snapshot: Snapshot | None, now_ns: int) -> tuple[str, str, bytes]:
    """Status line, content type and body for a path."""
    text = "text/plain; charset=utf-8"
    if path not in ("/metrics", "/healthz"):
        return "404 Not Found", text, b"/metrics or /healthz\n"
    if snapshot is None:
        return "503 Service Unavailable", text, b"starting\n"
    if path == "/metrics":
        return "200 OK", CONTENT_TYPE, metrics_text(snapshot)
    ok, words = health(snapshot, now_ns)
    return "200 OK" if ok else "503 Service Unavailable", text, f"{words}\n".encode()
