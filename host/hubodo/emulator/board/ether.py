"""What boards with radios share: one time, in whose order all of them act, and an air that loses packets."""

from __future__ import annotations

import heapq
import random
import threading
from collections import Counter
from collections.abc import Callable
from typing import TypeVar

from hubodo.emulator.chips.espnow import EspNow
from hubodo.emulator.chips.nrf24 import Nrf24, Weather

_CALM = Weather()
Done = TypeVar("Done")


class Ether:
    """Boards act in the order of their times: one that is ahead waits for the others.

    A board says with `reached` that it does nothing before a time; `act` waits until all others have reached
    it, lets happen what was to happen by then, and then does what the board does. counts: what was lost.
    """

    def __init__(self, weather: Weather = _CALM, seed: int = 0) -> None:
        self.weather = weather
        self.random = random.Random(seed)
        self.counts: Counter[str] = Counter()
        self._turn = threading.Condition(threading.RLock())
        self._reached: dict[object, float] = {}
        self._events: list[tuple[float, int, Callable[[float], None]]] = []
        self._made = 0
        self._wanted: list[float] = []
        """The times that boards wait for."""
        self.radios: list[Nrf24] = []
        self.stations: list[EspNow] = []
        self.busy_until = 0.0
        """When what is on the air of the stations is over, ns."""

    def join(self, board: object) -> None:
        """A board that takes part from now on, with its time at 0."""
        with self._turn:
            self._reached[board] = 0.0

    def leave(self, board: object) -> None:
        """A board that is switched off; nobody waits for it."""
        with self._turn:
            self._reached.pop(board, None)
            self._turn.notify_all()

    def reached(self, board: object, t: float) -> None:
        """The board does nothing before t, ns."""
        with self._turn:
            before = self._reached.get(board, t)
            if t > before:
                self._reached[board] = t
                if any(before < wanted <= t for wanted in self._wanted):
                    self._turn.notify_all()

    def act(self, board: object, t: float, do: Callable[[], Done]) -> Done:
        """What a board does at t, ns, in its turn."""
        with self._turn:
            self.reached(board, t)
            while any(other is not board and now < t for other, now in self._reached.items()):
                self._wanted.append(t)
                self._turn.wait()
                self._wanted.remove(t)
            self._happen(t)
            return do()

    def later(self, t: float, what: Callable[[float], None]) -> None:
        """Lets something happen at t, ns; it gets that time."""
        self._made += 1
        heapq.heappush(self._events, (t, self._made, what))

    def lost(self, kind: str) -> bool:
        """Whether the next packet is lost, and counted as such."""
        gone = self.random.random() < self.weather.lose
        self.counts[kind] += 1
        self.counts[f"{kind} lost"] += gone
        return gone

    def _happen(self, t: float) -> None:
        while self._events and self._events[0][0] <= t:
            when, _, what = heapq.heappop(self._events)
            what(when)
