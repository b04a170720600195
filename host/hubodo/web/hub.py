"""From one recording to many pages: the last minute kept, and handed on to each as fast as it reads."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import AsyncIterator
from itertools import islice
from typing import Any

from hubodo.safe_text import json_text
from hubodo.web.frames import Frame
from hubodo.web.thin_path import ThinPath

HISTORY = 600
"""Frames: a minute at ten a second."""

_BEHIND = 50
_MOST_EVENTS = 200
_WAITING = 64


class Hub:
    """Frames come in from the thread of the recording with `put`, and go out on the loop of the server.

    Nothing here grows: a page that reads too slowly is not queued for; it begins anew with the history.
    """

    def __init__(self, about: dict[str, Any]) -> None:
        """about: what every page is told first."""
        self._about = about
        self._loop: asyncio.AbstractEventLoop | None = None
        self._incoming: deque[Frame] = deque(maxlen=_WAITING)
        self._woken = False
        self._frames: deque[str] = deque(maxlen=HISTORY)
        self._count = 0
        self._changed = asyncio.Event()
        self._trails = {"o": ThinPath(), "m": ThinPath(), "g": ThinPath()}
        self._events: deque[Frame] = deque(maxlen=_MOST_EVENTS)
        self._slow: Frame | None = None

    def attach(self, loop: asyncio.AbstractEventLoop, **about: Any) -> None:
        """From now on frames are taken on this loop; about: what pages are told first, besides."""
        self._loop = loop
        self._about.update(about)

    def put(self, frame: Frame) -> None:
        """From any thread; returns at once, whatever the pages do."""
        self._incoming.append(frame)
        if self._loop is not None and not self._woken:
            self._woken = True
            try:
                self._loop.call_soon_threadsafe(self._take)
            except RuntimeError:  # the server has stopped
                self._loop = None

    @property
    def slow(self) -> Frame | None:
        """The newest of what changes slowly."""
        return self._slow

    async def follow(self) -> AsyncIterator[str]:
        """What a page is sent, as JSON texts: what has been first, then what comes."""
        at = self._count
        yield self._hello()
        while True:
            while at == self._count:
                await self._changed.wait()
            if self._count - at > _BEHIND:
                at = self._count
                yield self._hello()
                continue
            fresh = list(islice(self._frames, len(self._frames) - (self._count - at), None))
            at = self._count
            yield fresh[0] if len(fresh) == 1 else f'{{"many":[{",".join(fresh)}]}}'

    def _take(self) -> None:
        self._woken = False
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
            self._trails["g"] = ThinPath()
        for key, trail in self._trails.items():
            if key in frame:
                trail.add(frame[key][0], frame[key][1])
        self._events.extend(frame.get("e", ()))
        self._slow = frame.get("s", self._slow)

    def _hello(self) -> str:
        past = {
            **self._about,
            "trails": {key: trail.points for key, trail in self._trails.items()},
            "events": list(self._events),
        }
        head = json_text(past, compact=True)
        return f'{{"hello":{head},"history":[{",".join(self._frames)}]}}'
