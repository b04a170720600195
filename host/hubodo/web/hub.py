"""Distribution of the frames of one recording to many pages, with the last minute as history."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import AsyncIterator
from itertools import islice
from typing import Any

from hubodo.safe_text import json_text
from hubodo.web.frames import Frame
from hubodo.web.thin_path import ThinnedPath

HISTORY_FRAMES = 600
"""One minute at ten frames per second."""

_MAX_LAG_FRAMES = 50
_MAX_HISTORY_EVENTS = 200
_MAX_INCOMING_FRAMES = 64


class FrameHub:
    """A distributor of frames from the thread of the recording to pages on the server's event loop.

    Memory is bounded: a page that reads too slowly is not buffered, but restarts with the history.
    """

    def __init__(self, about: dict[str, Any]) -> None:
        """Create a hub; `about` is sent to each page first."""
        self._about = about
        self._loop: asyncio.AbstractEventLoop | None = None
        self._incoming: deque[Frame] = deque(maxlen=_MAX_INCOMING_FRAMES)
        self._is_scheduled = False
        self._frames: deque[str] = deque(maxlen=HISTORY_FRAMES)
        self._count = 0
        self._changed = asyncio.Event()
        self._trails = {"o": ThinnedPath(), "m": ThinnedPath(), "g": ThinnedPath()}
        self._events: deque[Frame] = deque(maxlen=_MAX_HISTORY_EVENTS)

    def attach(self, loop: asyncio.AbstractEventLoop, **about: Any) -> None:
        """Set the event loop, and add items to what pages receive first."""
        self._loop = loop
        self._about.update(about)

    def put(self, frame: Frame) -> None:
        """Queue a frame; callable from any thread, never blocks."""
        self._incoming.append(frame)
        if self._loop is not None and not self._is_scheduled:
            self._is_scheduled = True
            try:
                self._loop.call_soon_threadsafe(self._process_incoming)
            except RuntimeError:  # the server has stopped
                self._loop = None

    async def subscribe(self) -> AsyncIterator[str]:
        """Yield JSON texts for a page: the history, then new frames."""
        position = self._count
        yield self._first_message()
        while True:
            while position == self._count:
                await self._changed.wait()
            if self._count - position > _MAX_LAG_FRAMES:
                position = self._count
                yield self._first_message()
                continue
            fresh = list(islice(self._frames, len(self._frames) - (self._count - position), None))
            position = self._count
            yield fresh[0] if len(fresh) == 1 else f'{{"many":[{",".join(fresh)}]}}'

    def _process_incoming(self) -> None:
        self._is_scheduled = False
        while self._incoming:
            frame = self._incoming.popleft()
            self._remember(frame)
            self._frames.append(json_text(frame, compact=True))
            self._count += 1
        changed, self._changed = self._changed, asyncio.Event()
        changed.set()

    def _remember(self, frame: Frame) -> None:
        if "origin" in frame:
            self._about["origin"] = frame["origin"]
            self._trails["g"] = ThinnedPath()
        for key, trail in self._trails.items():
            if key in frame:
                trail.add(frame[key][0], frame[key][1])
        self._events.extend(frame.get("e", ()))

    def _first_message(self) -> str:
        overview = {
            **self._about,
            "trails": {key: trail.points for key, trail in self._trails.items()},
            "events": list(self._events),
        }
        head = json_text(overview, compact=True)
        return f'{{"hello":{head},"history":[{",".join(self._frames)}]}}'
