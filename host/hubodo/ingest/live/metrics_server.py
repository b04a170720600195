"""HTTP server of `/metrics` and `/healthz` in a thread of its own."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from types import TracebackType
from typing import Self

from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from hubodo.errors import InputError
from hubodo.ingest.live.metrics import CONTENT_TYPE, assess_health, metrics_text
from hubodo.ingest.live.snapshot import Snapshot
from hubodo.listening.listener import BoundedListener
from hubodo.listening.server_thread import ServerFaults, server_config, server_thread


class MetricsServer:
    """An HTTP server of the newest snapshot; a context manager.

    address: HOST:PORT, port 0 for any free port. now_ns: host time. Raises InputError when the address is
    invalid or in use.
    """

    def __init__(self, address: str, now_ns: Callable[[], int]) -> None:
        host, colon, port = address.rpartition(":")
        if not colon or not (port.isascii() and port.isdigit()) or int(port) > 65535:
            raise InputError(f"metrics address {address!r}: write HOST:PORT, such as 127.0.0.1:9464")
        self._now_ns = now_ns
        self._newest: Snapshot | None = None
        self._running = ExitStack()
        self._faults = ServerFaults()
        try:
            self._listener = BoundedListener.listen_on(host.strip("[]"), int(port))
        except OSError as error:
            raise InputError(
                f"metrics address {address}: {error.strerror or error}; choose another port, or close "
                "the program that uses it"
            ) from None

    @property
    def port(self) -> int:
        """Port number on which the server listens."""
        return int(self._listener.getsockname()[1])

    def show(self, snapshot: Snapshot) -> None:
        """Serve this snapshot from now on; raise ServerEnded once if the server had to be restarted."""
        self._newest = snapshot
        self._faults.raise_next()

    def __enter__(self) -> Self:
        config = server_config(self._serve, self._listener, ws="none", lifespan="off")
        self._running.enter_context(server_thread(config, self._listener, "metrics", self._faults))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._running.close()

    async def _serve(self, scope: Scope, receive: Receive, send: Send) -> None:
        # Each connection is closed after one response, so none has to be admitted.
        status, kind, body = respond(scope["path"], self._newest, self._now_ns())
        headers = {"connection": "close"}
        await Response(body, status, headers, kind)(scope, receive, send)


def respond(path: str, snapshot: Snapshot | None, now_ns: int) -> tuple[int, str, bytes]:
    """Return the status, content type and body for a path."""
    text = "text/plain; charset=utf-8"
    if path not in ("/metrics", "/healthz"):
        return 404, text, b"/metrics or /healthz\n"
    if snapshot is None:
        return 503, text, b"starting\n"
    if path == "/metrics":
        return 200, CONTENT_TYPE, metrics_text(snapshot)
    ok, words = assess_health(snapshot, now_ns)
    return 200 if ok else 503, text, f"{words}\n".encode()
