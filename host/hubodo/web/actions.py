"""Actions that a visitor may request: bias initialisation, mark, end of the log, start of the next log."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hubodo.ingest.live.recorder import Recorder
from hubodo.ingest.live.snapshot import Snapshot
from hubodo.web.live_page import LivePage, RecorderTask
from hubodo.web.request_body import RequestRefused
from hubowire.messages import BiasInit

_MIN_BIAS_SAMPLES = 2000
_MAX_MARK_LENGTH = 200


class Actions:
    """The conversion of requests from visitors into tasks for the recording."""

    def __init__(self, page: LivePage) -> None:
        self._page = page

    @property
    def latest_snapshot(self) -> Snapshot | None:
        """Return the newest snapshot."""
        return self._page.latest_snapshot

    def now_ns(self) -> int:
        """Return the time of the recording's own clock, ns."""
        return self._page.now_ns()

    @property
    def current_log(self) -> Path | None:
        """Return the log that is being written, or None."""
        return self._page.current_log

    def request_action(self, action: str, body: dict[str, Any]) -> None:
        """Queue an action; raise RequestRefused if it is invalid. Its outcome becomes an event."""
        match action:
            case "bias":
                accepted = self._page.submit_task(
                    _bias(str(body.get("node")), body.get("samples", _MIN_BIAS_SAMPLES))
                )
            case "mark":
                accepted = self._page.submit_task(_mark(str(body.get("text", ""))))
            case "record" if isinstance(body.get("on"), bool):
                accepted = self._page.set_recording(body["on"])
            case _:
                raise RequestRefused(404, "bias with node, mark with text, or record with on")
        if not accepted:
            raise RequestRefused(429, "too many requests at once; wait a second")


def _bias(node: str, samples: object) -> RecorderTask:
    if not isinstance(samples, int) or not _MIN_BIAS_SAMPLES <= samples <= 65535:
        raise RequestRefused(400, f"samples: from {_MIN_BIAS_SAMPLES} to 65535")
    label = f"bias initialisation over {samples} samples"

    def wish(recorder: Recorder) -> None:
        recorder.request(node, BiasInit(samples), label)

    return wish


def _mark(text: str) -> RecorderTask:
    printable = "".join(letter if letter.isprintable() else " " for letter in text)
    line = " ".join(printable.split())[:_MAX_MARK_LENGTH] or "mark"

    def wish(recorder: Recorder) -> None:
        recorder.add_mark(line)

    return wish
