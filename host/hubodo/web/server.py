"""The page's server: where it listens, with which certificate."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from starlette.types import ASGIApp

from hubodo.errors import InputError
from hubodo.listening.server_thread import ServerFaults, server_config, server_thread
from hubodo.web.config import Site

_LARGEST_MESSAGE = 4096
"""B from a browser; it has nothing to say on the live feed."""


@contextlib.contextmanager
def serving(app: ASGIApp, site: Site, faults: ServerFaults | None = None) -> Iterator[int]:
    """Serve inside the block; gives the port. faults: get what ends the server meanwhile.

    Raises InputError where it cannot listen or use the certificate.
    """
    listener = site.address.listen()
    config = server_config(
        app,
        listener,
        ws="websockets-sansio",
        ws_max_size=_LARGEST_MESSAGE,
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
