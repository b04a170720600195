"""Rate of guessing a token, and duration of its owner's login meanwhile; `make faults` prints both.

`python tests/faults/guessing.py` prints them alone.
"""

from __future__ import annotations

import http.client
import sys
import tempfile
import threading
import time
import urllib.parse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from hubodo.web.address import Address
from hubodo.web.app import make_app
from hubodo.web.config import Site
from hubodo.web.library import RecordingLibrary
from hubodo.web.server import serve_in_thread

TOKEN = "correct-horse-battery"
GUESSERS = 60
VERIFIED = (401, 403)
"""Statuses of a secret that was compared and is wrong; a refusal to compare is 429."""

Request = Callable[[http.client.HTTPConnection, str], int]


@dataclass(frozen=True)
class Guessing:
    """Guesses achieved by `GUESSERS` connections that guess as fast as they are answered."""

    path: str
    guesses_per_s: float
    """Secrets that were compared, by all guessers together, all from one address."""
    login_s: float
    """The owner's login from that address meanwhile; the slowest of three."""
    login_elsewhere_s: float
    """The same from another address."""

    def __str__(self) -> str:
        return (
            f"{GUESSERS} connections guess by {self.way}: {self.guesses_per_s:.0f} guesses/s; the owner logs "
            f"in within {self.login_s:.2f} s from their address, {self.login_elsewhere_s:.2f} s from another"
        )


def by_login(connection: http.client.HTTPConnection, secret: str) -> int:
    body = urllib.parse.urlencode({"token": secret})
    connection.request("POST", "/login", body, {"content-type": "application/x-www-form-urlencoded"})
    return _status(connection)


def by_bearer(connection: http.client.HTTPConnection, secret: str) -> int:
    connection.request("GET", "/api/recordings", headers={"authorization": f"Bearer {secret}"})
    return _status(connection)


def by_cookie(connection: http.client.HTTPConnection, secret: str) -> int:
    connection.request("GET", "/api/recordings", headers={"cookie": f"hubodo={secret}"})
    return _status(connection)


WAYS: dict[str, Request] = {"login form": by_login, "Authorization": by_bearer, "cookie": by_cookie}


def measure(path: str, seconds: float = 4.0) -> Guessing:
    """Guess for `seconds` on one server, and log in meanwhile."""
    ask, verified, stop = WAYS[path], [0] * GUESSERS, threading.Event()

    def guess(place: int, port: int) -> None:
        number = 0
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
        while not stop.is_set():
            number += 1
            try:
                verified[place] += ask(connection, f"guess-{place}-{number}-of-many") in VERIFIED
            except (OSError, http.client.HTTPException):
                connection.close()

    site = Site(Address("127.0.0.1", 0), TOKEN)
    with (
        tempfile.TemporaryDirectory() as folder,
        serve_in_thread(make_app(site, RecordingLibrary(Path(folder))), site) as port,
    ):
        threads = [threading.Thread(target=guess, args=(place, port)) for place in range(GUESSERS)]
        start = time.monotonic()
        for thread in threads:
            thread.start()
        try:
            stop.wait(seconds / 2)
            here = max(login_time(port, "127.0.0.1") for _ in range(3))
            elsewhere = login_time(port, "127.0.0.2")
            stop.wait(max(start + seconds - time.monotonic(), 0.0))
            guesses_per_s = sum(verified) / (time.monotonic() - start)
        finally:
            stop.set()
            for thread in threads:
                thread.join()
    return Guessing(path, guesses_per_s, here, elsewhere)


def login_time(port: int, source: str) -> float:
    """Return how long a login with the valid token takes from an address of this computer, s."""
    start = time.monotonic()
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60, source_address=(source, 0))
    status = by_login(connection, TOKEN)
    connection.close()
    return time.monotonic() - start if status == 303 else float("inf")


def _status(connection: http.client.HTTPConnection) -> int:
    answer = connection.getresponse()
    answer.read()
    return answer.status


def main() -> int:
    for path in WAYS:
        print(measure(path), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
