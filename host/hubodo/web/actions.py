"""What a visitor may have done: a bias initialisation, a mark, the end of the log and the next one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hubodo.ingest.live.recorder import Recorder
from hubodo.ingest.live.snapshot import Snapshot
from hubodo.web.asked import NotServed
from hubodo.web.live_page import LivePage, Wish
from hubowire.messages import BiasInit

_SAMPLES = 2000
_LONGEST_MARK = 200


class Actions:
    """Turns what was asked for into wishes for the recording."""

    def __init__(self, page: LivePage) -> None:
        self._page = page

    @property
    def newest(self) -> Snapshot | None:
        """The newest snapshot."""
        return self._page.newest

    def now_ns(self) -> int:
        """Return the time of the recording's own clock."""
        return self._page.now_ns()

    @property
    def file(self) -> Path | None:
        """The log that is being written."""
        return self._page.file

    def do(self, action: str, asked: dict[str, Any]) -> None:
        """Raises NotServed for what makes no sense; what comes of the rest is an event on the page."""
        match action:
            case "bias":
                taken = self._page.wish(_bias(str(asked.get("node")), asked.get("samples", _SAMPLES)))
            case "mark":
                taken = self._page.wish(_mark(str(asked.get("text", ""))))
            case "record" if isinstance(asked.get("on"), bool):
                taken = self._page.record(asked["on"])
            case _:
                raise NotServed(404, "bias with node, mark with text, or record with on")
        if not taken:
            raise NotServed(429, "too many wishes at once; wait a second")


def _bias(node: str, samples: object) -> Wish:
    if not isinstance(samples, int) or not _SAMPLES <= samples <= 65535:
        raise NotServed(400, f"samples: from {_SAMPLES} to 65535")
    words = f"bias initialisation over {samples} samples"

    def wish(recorder: Recorder) -> None:
        recorder.request(node, BiasInit(samples), words)

    return wish


def _mark(text: str) -> Wish:
    printable = "".join(letter if letter.isprintable() else " " for letter in text)
    line = " ".join(printable.split())[:_LONGEST_MARK] or "mark"

    def wish(recorder: Recorder) -> None:
        recorder.add_mark(line)

    return wish
