"""`/metrics` and `/healthz` over HTTP, from a thread of their own, for a recording without the live page."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from types import TracebackType
from typing import Self

from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from hubodo.errors import InputError
from hubodo.ingest.live.metrics import CONTENT_TYPE, health, metrics_text
from hubodo.ingest.live.snapshot import Snapshot
from hubodo.listening.listener import BoundedListener
from hubodo.listening.server_thread import ServerFaults, server_config, server_thread


class MetricsServer:
    """Serves the newest snapshot that it was given; a context manager.

    address: HOST:PORT, port 0 for any that is free. now_ns: host time. Raises InputError where the address
    is none or is taken.
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
                "the program that has it"
            ) from None

    @property
    def port(self) -> int:
        """The port on which it listens."""
        return int(self._listener.getsockname()[1])

    def show(self, snapshot: Snapshot) -> None:
        """Serve this snapshot from now on. Raises ServerEnded, once, where the server had to be restarted."""
        self._newest = snapshot
        self._faults.raise_next()

    def __enter__(self) -> Self:
        config = server_config(self._answer, self._listener, ws="none", lifespan="off")
        self._running.enter_context(server_thread(config, self._listener, "metrics", self._faults))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._running.close()

    async def _answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        # One answer for each connection: none of them has to be admitted, and none stays.
        status, kind, body = answer(scope["path"], self._newest, self._now_ns())
        headers = {"connection": "close"}
        await Response(body, status, headers, kind)(scope, receive, send)


def answer(path: str, snapshot: Snapshot | None, now_ns: int) -> tuple[int, str, bytes]:
    """Return the status, content type and body for a path."""
    text = "text/plain; charset=utf-8"
    if path not in ("/metrics", "/healthz"):
        return 404, text, b"/metrics or /healthz\n"
    if snapshot is None:
        return 503, text, b"starting\n"
    if path == "/metrics":
        return 200, CONTENT_TYPE, metrics_text(snapshot)
    ok, words = health(snapshot, now_ns)
    return 200 if ok else 503, text, f"{words}\n".encode()
