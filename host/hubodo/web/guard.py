"""Who may speak to the server: the names used for it, the page that asks, the token, the cookie.

Every request passes here before anything else sees it.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
from collections.abc import Iterable
from http.cookies import CookieError, SimpleCookie
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Receive, Scope, Send

from hubodo.listening.server_thread import admit
from hubodo.web.address import host_allowed, split_host
from hubodo.web.config import Site

COOKIE = "hubodo"
CSRF_HEADER = "x-hubodo-token"
OPEN_PATHS = ("/login", "/static/style.css", "/static/icon.svg")
"""What somebody without the token may see: nothing of the recording."""

_HEADERS = (
    (
        b"content-security-policy",
        b"default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
        b"connect-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'; "
        b"manifest-src 'self'",
    ),
    (b"x-content-type-options", b"nosniff"),
    # Not "no-referrer": with that a browser sends forms with the origin "null".
    (b"referrer-policy", b"same-origin"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cache-control", b"no-store"),
)
_ASKING = ("GET", "HEAD")


class Secrets:
    """What visitors must know. csrf: known to pages that this server gave out since its start."""

    def __init__(self, token: str | None) -> None:
        self.csrf = secrets.token_urlsafe(24)
        self._token = token
        # The same after a restart, so that a page that stays open goes on; worthless once the token changes.
        self.cookie = "" if token is None else hmac.digest(token.encode(), b"cookie", hashlib.sha256).hex()

    @property
    def asked_for(self) -> bool:
        """Whether there is a token."""
        return self._token is not None

    def is_token(self, given: str) -> bool:
        """Takes as long for a wrong one, wherever it is wrong."""
        return self._token is not None and _equal(given, self._token)

    def is_cookie(self, given: str) -> bool:
        """Likewise."""
        return bool(self.cookie) and _equal(given, self.cookie)

    def is_csrf(self, given: str) -> bool:
        """Likewise."""
        return _equal(given, self.csrf)


def _equal(given: str, wanted: str) -> bool:
    return hmac.compare_digest(given.encode("utf-8", "replace"), wanted.encode())


class Guard:
    """ASGI middleware around the whole application."""

    def __init__(self, app: ASGIApp, site: Site, secrets: Secrets) -> None:
        self._app = app
        self._site = site
        self._secrets = secrets

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        refusal = self._refusal(scope)
        if refusal is None:
            if scope["path"] not in OPEN_PATHS:
                admit(scope)
            await self._app(scope, receive, _with_headers(send))
        elif scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 4403, "reason": ""})
        else:
            await refusal(scope, receive, _with_headers(send))

    def _refusal(self, scope: Scope) -> Response | None:
        headers = Headers(scope=scope)
        name = split_host(headers.get("host", ""))
        if not host_allowed(name, self._site.address, self._site.hosts):
            return _words(421, "this name is not one of this server; [web] hosts lists others")
        origin = headers.get("origin")
        asks = scope["type"] == "http" and scope["method"] in _ASKING
        if origin is not None and not asks and not self._same(origin, headers.get("host", "")):
            return _words(403, "asked by a page of another site")
        known = self._known(headers)
        if not known and scope["path"] not in OPEN_PATHS:
            if asks and "text/html" in headers.get("accept", ""):
                return RedirectResponse("/login", 303)
            return _words(401, "give the token: log in, or send it as Authorization: Bearer")
        if scope["type"] == "http" and not asks and scope["path"] != "/login":
            given = headers.get(CSRF_HEADER, "")
            if not self._secrets.is_csrf(given) and not self._bearer(headers):
                return _words(403, "the page is older than the server; load it again")
        return None

    def _same(self, origin: str, host: str) -> bool:
        parts = urlsplit(origin)
        return parts.scheme == ("http" if self._site.cert is None else "https") and parts.netloc == host

    def _known(self, headers: Headers) -> bool:
        if not self._secrets.asked_for:
            return True
        return self._bearer(headers) or any(map(self._secrets.is_cookie, _cookies(headers)))

    def _bearer(self, headers: Headers) -> bool:
        scheme, _, given = headers.get("authorization", "").partition(" ")
        return scheme.lower() == "bearer" and self._secrets.is_token(given.strip())


def _cookies(headers: Headers) -> Iterable[str]:
    try:
        found = SimpleCookie(headers.get("cookie", ""))
    except CookieError:
        return ()
    return (found[COOKIE].value,) if COOKIE in found else ()


def _words(status: int, text: str) -> Response:
    return PlainTextResponse(text + "\n", status)


def _with_headers(send: Send) -> Send:
    """Adds what keeps a browser from doing more with an answer than the page needs."""

    async def sending(message: dict[str, object]) -> None:
        if message["type"] == "http.response.start":
            given = list(message.get("headers") or ())  # type: ignore[call-overload]
            there = {key.lower() for key, _ in given}
            message = {**message, "headers": [*given, *(pair for pair in _HEADERS if pair[0] not in there)]}
        await send(message)

    return sending  # type: ignore[return-value]
