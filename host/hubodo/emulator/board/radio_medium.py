"""Radio medium that several boards share: a common order of time, and packet faults."""

from __future__ import annotations

import heapq
import random
import threading
from collections import Counter
from collections.abc import Callable
from typing import Protocol, TypeVar

from hubodo.emulator.chips.espnow import EspNow
from hubodo.emulator.chips.nrf24 import Nrf24, PacketFaults

_NO_FAULTS = PacketFaults()
Result = TypeVar("Result")


class BluetoothRadio(Protocol):
    """The Bluetooth radio of a board; `t` in ns."""

    def handle_call(self, t: float, request: bytes) -> tuple[int, bytes]: ...

    def reset(self) -> None: ...


class RadioMedium:
    """Radio medium of several boards, which act in the order of their times.

    A board declares with `advance` that it does nothing before a time. `run_in_order` waits until all other
    boards have advanced to that time, runs the events scheduled before it, and then performs the action.
    `counts`: packets and losses, by kind. open_bluetooth: returns the Bluetooth radio of a board for
    its address and platform; see `chips.ble_peripheral`.
    """

    def __init__(
        self,
        packet_faults: PacketFaults = _NO_FAULTS,
        seed: int = 0,
        open_bluetooth: Callable[[bytes, str], BluetoothRadio] | None = None,
    ) -> None:
        self.open_bluetooth = open_bluetooth
        self.packet_faults = packet_faults
        self.random = random.Random(seed)
        self.counts: Counter[str] = Counter()
        self._condition = threading.Condition(threading.RLock())
        self._board_times: dict[object, float] = {}
        self._events: list[tuple[float, int, Callable[[float], None]]] = []
        self._event_count = 0
        self._waited_times: list[float] = []
        """Times that boards wait for, ns."""
        self.radios: list[Nrf24] = []
        self.stations: list[EspNow] = []
        self.busy_until = 0.0
        """End of the current transmission of ESP-NOW stations, ns."""

    def add_board(self, board: object) -> None:
        """Add a board, at time 0."""
        with self._condition:
            self._board_times[board] = 0.0

    def remove_board(self, board: object) -> None:
        """Remove a board that is switched off."""
        with self._condition:
            self._board_times.pop(board, None)
            self._condition.notify_all()

    def advance(self, board: object, t: float) -> None:
        """Declare that a board does nothing before t, ns."""
        with self._condition:
            old = self._board_times.get(board, t)
            if t > old:
                self._board_times[board] = t
                if any(old < waited <= t for waited in self._waited_times):
                    self._condition.notify_all()

    def run_in_order(self, board: object, t: float, action: Callable[[], Result]) -> Result:
        """Perform an action of a board at t, ns, once all other boards have reached t."""
        with self._condition:
            self.advance(board, t)
            while any(
                other_board is not board and board_time < t
                for other_board, board_time in self._board_times.items()
            ):
                self._waited_times.append(t)
                self._condition.wait()
                self._waited_times.remove(t)
            self._run_events(t)
            return action()

    def schedule(self, t: float, event: Callable[[float], None]) -> None:
        """Schedule an event at t, ns; it is called with that time."""
        self._event_count += 1
        heapq.heappush(self._events, (t, self._event_count, event))

    def draw_loss(self, kind: str) -> bool:
        """Draw whether the next packet is lost, and count it."""
        is_lost = self.random.random() < self.packet_faults.loss
        self.counts[kind] += 1
        self.counts[f"{kind} lost"] += is_lost
        return is_lost

    def _run_events(self, t: float) -> None:
        """Run the events that are due at t."""
        while self._events and self._events[0][0] <= t:
            when, _, event = heapq.heappop(self._events)
            event(when)
