"""An ASGI server in a thread with its own event loop, so that clients do not delay a recording."""

from __future__ import annotations

import contextlib
import functools
import threading
from collections import deque
from collections.abc import Iterator
from typing import Any

import uvicorn
from starlette.types import ASGIApp, Receive, Scope, Send

from hubodo.listening.listener import MAX_ACCEPT_BATCH, BoundedListener

_STOP_TIMEOUT_S = 3.0
_MIN_PAUSE_S, _MAX_PAUSE_S = 1.0, 60.0
_MAX_STORED_ERRORS = 16
_MAX_REQUEST_HEADER_BYTES = 16_384
"""Maximum size of a request before its body."""
_ADMIT_KEY = "hubodo.admit"


def admit_connection(scope: Scope) -> None:
    """Admit the connection of this request, so that it is not dropped; see `BoundedListener`."""
    if admit := scope.get(_ADMIT_KEY):
        admit()


def server_config(app: ASGIApp, listener: BoundedListener, **settings: Any) -> uvicorn.Config:
    """Return the configuration of uvicorn; connections are bounded by the listener only.

    Headers that name another client (X-Forwarded-For) are ignored, because anybody can send them.
    """

    async def application(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] in ("http", "websocket"):
            scope[_ADMIT_KEY] = functools.partial(listener.admit, scope.get("client"))
        await app(scope, receive, send)

    async def expire() -> None:
        listener.expire()

    defaults: dict[str, Any] = {
        "loop": "asyncio",
        "http": "h11",
        "h11_max_incomplete_event_size": _MAX_REQUEST_HEADER_BYTES,
        "log_config": None,
        "access_log": False,
        "server_header": False,
        "proxy_headers": False,
        "backlog": MAX_ACCEPT_BATCH,
        "callback_notify": expire,
        "timeout_notify": 1,
        "timeout_graceful_shutdown": 1,
    }
    return uvicorn.Config(application, **{**defaults, **settings})


class ServerEnded(Exception):
    """Raised for a server that has ended unexpectedly."""


class ServerFaults:
    """Queue of errors that ended a server, for the thread that reports them."""

    def __init__(self) -> None:
        self._errors: deque[BaseException] = deque(maxlen=_MAX_STORED_ERRORS)

    def add(self, error: BaseException) -> None:
        """Queue an error; from any thread."""
        self._errors.append(error)

    def raise_next(self) -> None:
        """Raise ServerEnded for the oldest unreported error, if any."""
        if self._errors:
            error = self._errors.popleft()
            raise ServerEnded(f"the server has ended and was restarted: {error!r}") from error


@contextlib.contextmanager
def server_thread(
    config: uvicorn.Config, listener: BoundedListener, name: str, faults: ServerFaults | None = None
) -> Iterator[int]:
    """Serve inside the block and yield the port number; the socket is closed afterwards.

    A server that fails is restarted after 1 s, later after up to 60 s, and the error is added to `faults`.
    """
    stopping, servers = threading.Event(), [uvicorn.Server(config)]

    def serve() -> None:
        pause_s = _MIN_PAUSE_S
        while not stopping.is_set():
            # A server closes the sockets passed to it.
            error: BaseException = ServerEnded("without an error")
            try:
                servers[0].run(sockets=[listener.duplicate()])
            except BaseException as raised:  # noqa: BLE001 uvicorn raises SystemExit if it cannot start
                error = raised
            if stopping.is_set():
                return
            (faults or ServerFaults()).add(error)
            stopping.wait(pause_s)
            pause_s = min(2.0 * pause_s, _MAX_PAUSE_S)
            servers[0] = uvicorn.Server(config)

    thread = threading.Thread(target=serve, name=name, daemon=True)
    thread.start()
    try:
        yield listener.getsockname()[1]
    finally:
        stopping.set()
        servers[0].should_exit = True
        thread.join(_STOP_TIMEOUT_S)
        listener.close()
