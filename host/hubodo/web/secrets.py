"""What visitors must know: the token, a session derived from it, and the secret of the server's own pages."""

from __future__ import annotations

import hashlib
import hmac
import secrets
import time
from collections import OrderedDict
from collections.abc import Callable

SESSION_S = 30 * 86_400
"""A session ends this long after the login, whatever the browser says."""
_MOST_SESSIONS = 256
_CLOCK_STEP_S = 300.0
"""A session may be issued this far in the future: the clock may have been set back since."""


class Secrets:
    """Compares each of them in constant time. csrf: known to pages that this server gave out since its start.

    A session is `ISSUED.NONCE.MAC`: seconds since 1970, a random number, and the HMAC-SHA256 of both under
    the token. It survives a restart of the server, and is invalid once the token changes.
    """

    def __init__(self, token: str | None, now: Callable[[], float] = time.time) -> None:
        self.csrf = secrets.token_urlsafe(24)
        self._token, self._now = token, now
        self._verified: OrderedDict[bytes, float] = OrderedDict()
        self._ended: OrderedDict[bytes, None] = OrderedDict()

    @property
    def asked_for(self) -> bool:
        """Return True where there is a token."""
        return self._token is not None

    def is_token(self, given: str) -> bool:
        """Return True for the token."""
        return self._token is not None and _equal(given, self._token)

    def is_csrf(self, given: str) -> bool:
        """Return True for the secret of pages of this server."""
        return _equal(given, self.csrf)

    def begin_session(self) -> str:
        """Return a new session for a visitor who gave the token."""
        issued = int(self._now())
        signed = f"{issued}.{secrets.token_hex(8)}"
        session = f"{signed}.{self._mac(signed)}"
        self._remember(session, issued)
        return session

    def is_session(self, given: str) -> bool:
        """Return True for a session that has not ended."""
        signed, _, mac = given.rpartition(".")
        issued, _, _ = signed.partition(".")
        authentic = self._token is not None and _equal(mac, self._mac(signed))
        if not authentic or not (issued.isascii() and issued.isdigit() and len(issued) < 20):
            return False
        age = self._now() - int(issued)
        if not -_CLOCK_STEP_S <= age < SESSION_S or _digest(given) in self._ended:
            return False
        self._remember(given, int(issued))
        return True

    def is_known_session(self, given: str) -> bool:
        """Return True for a session that was verified before: no guess, so it needs no limit of guesses."""
        return self._now() < self._verified.get(_digest(given), 0.0)

    def end_session(self, given: str) -> None:
        """Make a session invalid until this server ends."""
        self._verified.pop(_digest(given), None)
        self._ended[_digest(given)] = None
        while len(self._ended) > _MOST_SESSIONS:
            self._ended.popitem(last=False)

    def _remember(self, session: str, issued: int) -> None:
        self._verified[_digest(session)] = issued + SESSION_S
        while len(self._verified) > _MOST_SESSIONS:
            self._verified.popitem(last=False)

    def _mac(self, signed: str) -> str:
        assert self._token is not None
        return hmac.digest(
            self._token.encode(), f"session {signed}".encode("utf-8", "replace"), "sha256"
        ).hex()


def _digest(session: str) -> bytes:
    return hashlib.sha256(session.encode("utf-8", "replace")).digest()


def _equal(given: str, wanted: str) -> bool:
    return hmac.compare_digest(given.encode("utf-8", "replace"), wanted.encode())
