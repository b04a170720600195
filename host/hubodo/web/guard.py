"""Access control of the server: host name, origin, token and session.

Every request passes this middleware first.
"""

from __future__ import annotations

from enum import Enum, auto
from http.cookies import CookieError, SimpleCookie
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Receive, Scope, Send

from hubodo.listening.server_thread import admit_connection
from hubodo.web.address import is_host_allowed, split_host
from hubodo.web.config import Site
from hubodo.web.guess_limiter import GuessLimiter, TooManyGuesses
from hubodo.web.secrets import AccessSecrets

COOKIE = "hubodo"
CSRF_HEADER = "x-hubodo-token"
OPEN_PATHS = ("/login", "/static/style.css", "/static/icon.svg")
"""Paths served without a token; they reveal nothing about the recording."""

_SECURITY_HEADERS = (
    (
        b"content-security-policy",
        b"default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
        b"connect-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'; "
        b"manifest-src 'self'",
    ),
    (b"x-content-type-options", b"nosniff"),
    # Not "no-referrer": browsers would send forms with the origin "null".
    (b"referrer-policy", b"same-origin"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cache-control", b"no-store"),
)
_READ_METHODS = ("GET", "HEAD")
_SESSION_KEY = "hubodo.session"


class Identity(Enum):
    """The proven identity of a visitor; ANYBODY if the server has no token."""

    ANYBODY = auto()
    SESSION = auto()
    TOKEN = auto()
    UNKNOWN = auto()


class AccessGuard:
    """ASGI middleware that checks each request before the application."""

    def __init__(self, app: ASGIApp, site: Site, secrets: AccessSecrets, limiter: GuessLimiter) -> None:
        self._app = app
        self._site = site
        self._secrets = secrets
        self._limiter = limiter

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        refusal = await self._refusal(scope)
        if refusal is None:
            if scope["path"] not in OPEN_PATHS:
                admit_connection(scope)
            await self._app(scope, receive, _with_headers(send))
        elif scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 4403, "reason": ""})
        else:
            await refusal(scope, receive, _with_headers(send))

    async def _refusal(self, scope: Scope) -> Response | None:
        headers = Headers(scope=scope)
        name = split_host(headers.get("host", ""))
        if not is_host_allowed(name, self._site.address, self._site.hosts):
            return _plain_response(421, "unknown host name; add it to [web] hosts")
        origin = headers.get("origin")
        is_read = scope["type"] == "http" and scope["method"] in _READ_METHODS
        if origin is not None and not is_read and not self._is_same_origin(origin, headers.get("host", "")):
            return _plain_response(403, "request by a page of another site")
        if scope["path"] in OPEN_PATHS:
            return None
        try:
            identity = await self._identify(scope, headers)
        except TooManyGuesses:
            return too_many_guesses_response()
        if identity is Identity.UNKNOWN:
            if is_read and "text/html" in headers.get("accept", ""):
                return RedirectResponse("/login", 303)
            return _plain_response(401, "give the token: log in, or send it as Authorization: Bearer")
        # Another site can make a browser send the session cookie, but not the token or the CSRF secret.
        proven = identity is Identity.TOKEN or self._secrets.is_csrf(headers.get(CSRF_HEADER, ""))
        if scope["type"] == "http" and not is_read and not proven:
            return _plain_response(403, "the page is older than the server; reload it")
        return None

    def _is_same_origin(self, origin: str, host: str) -> bool:
        try:
            parts = urlsplit(origin)
        except ValueError:  # such as an unclosed bracket
            return False
        return parts.scheme == ("http" if self._site.cert is None else "https") and parts.netloc == host

    async def _identify(self, scope: Scope, headers: Headers) -> Identity:
        secrets, token, session = self._secrets, _bearer(headers), _session(headers)
        if not secrets.is_token_required:
            return Identity.ANYBODY
        if session is not None and secrets.is_known_session(session):
            scope[_SESSION_KEY] = session
            return Identity.SESSION
        if token is not None:
            valid = await self._limiter.verify(client_address(scope), lambda: secrets.is_token(token))
            return Identity.TOKEN if valid else Identity.UNKNOWN
        if session is not None:
            scope[_SESSION_KEY] = session
            valid = await self._limiter.verify(client_address(scope), lambda: secrets.is_session(session))
            return Identity.SESSION if valid else Identity.UNKNOWN
        return Identity.UNKNOWN


def client_address(scope: Scope) -> str:
    """Return the IP number of the visitor."""
    client = scope.get("client")
    return "" if client is None else str(client[0])


def request_session(scope: Scope) -> str | None:
    """Return the session that identified the visitor, or None."""
    session = scope.get(_SESSION_KEY)
    return session if isinstance(session, str) else None


def too_many_guesses_response() -> Response:
    """Return the response to too many guesses."""
    answer = _plain_response(429, "too many invalid tokens from this address; wait a second")
    answer.headers["retry-after"] = "1"
    return answer


def _bearer(headers: Headers) -> str | None:
    scheme, _, token = headers.get("authorization", "").partition(" ")
    return token.strip() if scheme.lower() == "bearer" else None


def _session(headers: Headers) -> str | None:
    try:
        cookies = SimpleCookie(headers.get("cookie", ""))
    except CookieError:
        return None
    return cookies[COOKIE].value if COOKIE in cookies else None


def _plain_response(status: int, text: str) -> Response:
    return PlainTextResponse(text + "\n", status)


def _with_headers(send: Send) -> Send:
    """Add security headers to the responses."""

    async def sending(message: dict[str, object]) -> None:
        if message["type"] == "http.response.start":
            headers = list(message.get("headers") or ())  # type: ignore[call-overload]
            present = {key.lower() for key, _ in headers}
            message = {
                **message,
                "headers": [*headers, *(pair for pair in _SECURITY_HEADERS if pair[0] not in present)],
            }
        await send(message)

    return sending  # type: ignore[return-value]
