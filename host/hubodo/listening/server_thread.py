"""An ASGI application served from a thread with an event loop of its own: no visitor delays a recording."""

from __future__ import annotations

import contextlib
import functools
import threading
from collections.abc import Iterator
from typing import Any

import uvicorn
from starlette.types import ASGIApp, Receive, Scope, Send

from hubodo.listening.listener import ACCEPT_BATCH, BoundedListener

_STOP_S = 3.0
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


@contextlib.contextmanager
def server_thread(config: uvicorn.Config, listener: BoundedListener, name: str) -> Iterator[int]:
    """Serve inside the block; gives the port. The socket is closed afterwards."""
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, name=name, daemon=True)
    thread.start()
    try:
        yield listener.getsockname()[1]
    finally:
        server.should_exit = True
        thread.join(_STOP_S)
        listener.close()
