"""The secrets of visitors: the token, sessions derived from it, and the CSRF secret of the server's pages."""

from __future__ import annotations

import hashlib
import hmac
import secrets
import time
from collections import OrderedDict
from collections.abc import Callable

SESSION_LIFETIME_S = 30 * 86_400
"""Lifetime of a session after the login, regardless of the browser."""
_MAX_SESSIONS = 256
_MAX_CLOCK_STEP_S = 300.0
"""Tolerance for sessions issued in the future, in case the clock was set back."""


class AccessSecrets:
    """The secrets of the server, compared in constant time; `csrf` is known to its pages.

    A session is `ISSUED.NONCE.MAC`: seconds since 1970, a random number, and the HMAC-SHA256 of both under
    the token. It survives a restart of the server, and is invalid once the token changes.
    """

    def __init__(self, token: str | None, now: Callable[[], float] = time.time) -> None:
        self.csrf = secrets.token_urlsafe(24)
        self._token, self._now = token, now
        self._verified: OrderedDict[bytes, float] = OrderedDict()
        self._ended: OrderedDict[bytes, None] = OrderedDict()

    @property
    def is_token_required(self) -> bool:
        """Return True if visitors need a token."""
        return self._token is not None

    def is_token(self, secret: str) -> bool:
        """Return True if the secret is the token."""
        return self._token is not None and _equal(secret, self._token)

    def is_csrf(self, secret: str) -> bool:
        """Return True if the secret is the CSRF secret of this server."""
        return _equal(secret, self.csrf)

    def begin_session(self) -> str:
        """Return a new session for a visitor who gave the token."""
        issued = int(self._now())
        signed = f"{issued}.{secrets.token_hex(8)}"
        session = f"{signed}.{self._mac(signed)}"
        self._remember(session, issued)
        return session

    def is_session(self, secret: str) -> bool:
        """Return True for a valid session that has not ended."""
        signed, _, mac = secret.rpartition(".")
        issued, _, _ = signed.partition(".")
        authentic = self._token is not None and _equal(mac, self._mac(signed))
        if not authentic or not (issued.isascii() and issued.isdigit() and len(issued) < 20):
            return False
        age = self._now() - int(issued)
        if not -_MAX_CLOCK_STEP_S <= age < SESSION_LIFETIME_S or _digest(secret) in self._ended:
            return False
        self._remember(secret, int(issued))
        return True

    def is_known_session(self, secret: str) -> bool:
        """Return True for a session verified before; this is no guess, so it needs no rate limit."""
        return self._now() < self._verified.get(_digest(secret), 0.0)

    def end_session(self, secret: str) -> None:
        """Invalidate a session until this server ends."""
        self._verified.pop(_digest(secret), None)
        self._ended[_digest(secret)] = None
        while len(self._ended) > _MAX_SESSIONS:
            self._ended.popitem(last=False)

    def _remember(self, session: str, issued: int) -> None:
        self._verified[_digest(session)] = issued + SESSION_LIFETIME_S
        while len(self._verified) > _MAX_SESSIONS:
            self._verified.popitem(last=False)

    def _mac(self, signed: str) -> str:
        assert self._token is not None
        return hmac.digest(
            self._token.encode(), f"session {signed}".encode("utf-8", "replace"), "sha256"
        ).hex()


def _digest(session: str) -> bytes:
    return hashlib.sha256(session.encode("utf-8", "replace")).digest()


def _equal(secret: str, expected: str) -> bool:
    return hmac.compare_digest(secret.encode("utf-8", "replace"), expected.encode())
