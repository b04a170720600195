"""The server in a thread of its own, with a loop of its own: a browser never holds a recording up."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator

import uvicorn
from starlette.types import ASGIApp

from hubodo.errors import InputError
from hubodo.web.config import Site

_STOP_S = 3.0
_MOST_CONNECTIONS = 100
_LARGEST_MESSAGE = 4096
"""B from a browser; it has nothing to say on the live feed."""


@contextlib.contextmanager
def serving(app: ASGIApp, site: Site) -> Iterator[int]:
    """Serves until left; gives the port. Raises InputError where it cannot listen or use the certificate."""
    socket = site.address.listen()
    config = uvicorn.Config(
        app,
        log_config=None,
        access_log=False,
        server_header=False,
        ws="websockets-sansio",
        ws_max_size=_LARGEST_MESSAGE,
        ws_per_message_deflate=False,
        limit_concurrency=_MOST_CONNECTIONS,
        timeout_graceful_shutdown=1,
        ssl_certfile=site.cert,
        ssl_keyfile=site.key,
    )
    try:
        config.load()
    except OSError as error:
        socket.close()
        raise InputError(f"{site.cert}, {site.key}: no certificate and key in PEM: {error}") from None
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, kwargs={"sockets": [socket]}, name="hubodo web", daemon=True)
    thread.start()
    try:
        yield socket.getsockname()[1]
    finally:
        server.should_exit = True
        thread.join(_STOP_S)
        socket.close()
