"""Requests to the live page with bodies that are invalid JSON or nonsensical."""

from __future__ import annotations

import json
import random
import warnings
from pathlib import Path
from typing import Any

from fuzz.case import Case, Defect

PATHS = ("/api/do/mark", "/api/do/bias", "/api/do/record", "/api/do/x", "/api/jobs", "/login")
VALUES: tuple[Any, ...] = (
    None, True, 0, -1, 2000, 1 << 70, 1e308, float("nan"), float("inf"), "", "left", "\ud800", "\x1b[2J",
    "é" * 300, [], {}, [[]],
    "../../etc/passwd", "log.mcap", {"a": 1},
)  # fmt: skip
KEYS = ("text", "node", "samples", "on", "recording", "verb", "model", "token", "file", "")
RAW = (
    b"", b"{", b"[" * 5000, b'{"a":' * 2000, b"\xff\xfe", b'{"text": "\\ud800"}', b"9" * 5000,
    b'{"samples": ' + b"9" * 5000 + b"}",
    b"null", b"[]", b'"x"', b"{}" * 9, b"x" * 300_000, b"token=%ff&token=%00", b"&" * 2000, b"\x00",
)  # fmt: skip


def http_case(rng: random.Random) -> Case:
    """One request with a body; the words are its path and its content type."""
    if rng.random() < 0.3:
        body = rng.choice(RAW)
    else:
        content = {rng.choice(KEYS): rng.choice(VALUES) for _ in range(rng.randint(0, 3))}
        body = json.dumps(content).encode()
        if rng.random() < 0.2 and body:
            place = rng.randrange(len(body))
            body = body[:place] + bytes([rng.randrange(256)]) + body[place + 1 :]
    kind = rng.choice(
        ("application/json", "application/json", "text/plain", "application/x-www-form-urlencoded", "")
    )
    return Case(("http", rng.choice(PATHS), kind), {"body": body})


def request(case: Case, folder: Path) -> None:
    """Send the request to the page and apply what it asked for to a recorder. Raises Defect."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its client is to be replaced by another one
        from starlette.testclient import TestClient

    from hubodo.ingest.live.recorder import Recorder
    from hubodo.log.log_writer import LogWriter
    from hubodo.web.actions import Actions
    from hubodo.web.address import Address
    from hubodo.web.app import make_app
    from hubodo.web.config import Site
    from hubodo.web.guard import CSRF_HEADER
    from hubodo.web.hub import FrameHub
    from hubodo.web.library import RecordingLibrary

    tasks: list[Any] = []

    class Page:
        """A stand-in for the page of a recording that accepts requests."""

        latest_snapshot = current_log = None

        def submit_task(self, task: Any) -> bool:
            tasks.append(task)
            return True

        def set_recording(self, on: bool) -> bool:
            return True

    app = make_app(Site(Address("127.0.0.1", 8642)), RecordingLibrary(folder), FrameHub({}), Actions(Page()))  # type: ignore[arg-type]
    _, path, kind = case.words
    with TestClient(app, base_url="http://127.0.0.1:8642", follow_redirects=False) as client:
        headers = {CSRF_HEADER: app.state.secrets.csrf, "content-type": kind}
        answer = client.post(path, content=case.files["body"], headers=headers)
    if answer.status_code >= 500:
        raise Defect(f"{' '.join(case.words)}: status {answer.status_code}")
    with LogWriter(folder / "log.mcap", clock=lambda: 5, t_zero_ns=0) as log:
        recorder = Recorder({"left": None}, log, lambda link, data, to: True, lambda: 5, t_zero_ns=0)
        for task in tasks:
            task(recorder)
        for notice in recorder.notices:
            str(getattr(notice, "text", notice)).encode()
        recorder.close()
