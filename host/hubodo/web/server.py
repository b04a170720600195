"""The HTTP server of the page, with its address and certificate."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from starlette.types import ASGIApp

from hubodo.errors import InputError
from hubodo.listening.server_thread import ServerFaults, server_config, server_thread
from hubodo.web.config import Site

_MAX_MESSAGE_BYTES = 4096
"""Longest message from a browser; the live feed expects none."""


@contextlib.contextmanager
def serve_in_thread(app: ASGIApp, site: Site, faults: ServerFaults | None = None) -> Iterator[int]:
    """Serve inside the block and yield the port; `faults` collects errors that end the server.

    Raises InputError if the address or the certificate cannot be used.
    """
    listener = site.address.listen()
    config = server_config(
        app,
        listener,
        ws="websockets-sansio",
        ws_max_size=_MAX_MESSAGE_BYTES,
        ws_per_message_deflate=False,
        ssl_certfile=site.cert,
        ssl_keyfile=site.key,
    )
    try:
        config.load()
    except OSError as error:
        listener.close()
        raise InputError(f"{site.cert}, {site.key}: no certificate and key in PEM: {error}") from None
    with server_thread(config, listener, "hubodo web", faults) as port:
        yield port
