"""An ASGI application served from a thread with an event loop of its own: no visitor delays a recording."""

from __future__ import annotations

import contextlib
import functools
import threading
from collections import deque
from collections.abc import Iterator
from typing import Any

import uvicorn
from starlette.types import ASGIApp, Receive, Scope, Send

from hubodo.listening.listener import ACCEPT_BATCH, BoundedListener

_STOP_S = 3.0
_MIN_PAUSE_S, _MAX_PAUSE_S = 1.0, 60.0
_MAX_ERRORS = 16
_LONGEST_HEAD = 16_384
"""B of a request before its body."""
_ADMIT = "hubodo.admit"


def admit(scope: Scope) -> None:
    """Keep the connection of this request when connections are shed; see `BoundedListener`."""
    if keep := scope.get(_ADMIT):
        keep()


def server_config(app: ASGIApp, listener: BoundedListener, **settings: Any) -> uvicorn.Config:
    """Return the settings of uvicorn, without any that would bound connections in a second way.

    Headers that name another client (X-Forwarded-For) are not believed: anybody can send them.
    """

    async def application(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] in ("http", "websocket"):
            scope[_ADMIT] = functools.partial(listener.admit, scope.get("client"))
        await app(scope, receive, send)

    async def expire() -> None:
        listener.expire()

    defaults: dict[str, Any] = {
        "loop": "asyncio",
        "http": "h11",
        "h11_max_incomplete_event_size": _LONGEST_HEAD,
        "log_config": None,
        "access_log": False,
        "server_header": False,
        "proxy_headers": False,
        "backlog": ACCEPT_BATCH,
        "callback_notify": expire,
        "timeout_notify": 1,
        "timeout_graceful_shutdown": 1,
    }
    return uvicorn.Config(application, **{**defaults, **settings})


class ServerEnded(Exception):
    """A server has ended although nobody asked it to."""


class ServerFaults:
    """Errors that ended a server, until the thread that reports them takes them."""

    def __init__(self) -> None:
        self._errors: deque[BaseException] = deque(maxlen=_MAX_ERRORS)

    def add(self, error: BaseException) -> None:
        """Keep an error; from any thread."""
        self._errors.append(error)

    def raise_next(self) -> None:
        """Raise ServerEnded for the oldest error that has not been reported, if there is one."""
        if self._errors:
            error = self._errors.popleft()
            raise ServerEnded(f"the server has ended and was started again: {error!r}") from error


@contextlib.contextmanager
def server_thread(
    config: uvicorn.Config, listener: BoundedListener, name: str, faults: ServerFaults | None = None
) -> Iterator[int]:
    """Serve inside the block; gives the port. The socket is closed afterwards.

    A server that fails is started again after 1 s, later after up to 60 s; `faults` gets the error.
    """
    stopping, servers = threading.Event(), [uvicorn.Server(config)]

    def serve() -> None:
        pause_s = _MIN_PAUSE_S
        while not stopping.is_set():
            # A server closes the sockets that it was given.
            error: BaseException = ServerEnded("without an error")
            try:
                servers[0].run(sockets=[listener.duplicate()])
            except BaseException as raised:  # noqa: BLE001 uvicorn exits where it cannot start
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
        thread.join(_STOP_S)
        listener.close()
