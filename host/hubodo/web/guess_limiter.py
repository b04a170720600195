"""A rate limit for guessing secrets, common to all ways of logging in, by address of the visitor.

Each invalid secret uses up an allowance of its address. An address without allowance is still served: each of
its secrets is compared only after HOLD_S, at most HELD_PER_ADDRESS at once; further ones are refused unread.
So an address gets HELD_PER_ADDRESS / HOLD_S guesses per second, whatever it does with its connections, and an
owner behind the same address waits for HOLD_S, not for the guesses of others.

The two bounds are coupled: a server that accepts its owner within 1 s, and cannot distinguish the owner from
N visitors of the same address, must compare the secrets of all of them within that second.
"""

from __future__ import annotations

import asyncio
import ipaddress
import time
from collections import Counter, OrderedDict
from collections.abc import Awaitable, Callable

HOLD_S = 0.75
HELD_PER_ADDRESS = 64
ALLOWANCE, ALLOWANCE_PER_S = 8.0, 2.0
"""Invalid secrets that an address may send before it is delayed, and their recovery per second."""
TOTAL_ALLOWANCE, TOTAL_ALLOWANCE_PER_S = 64.0, 4.0
"""Invalid secrets from all addresses together, and their recovery per second; limits distributed guessing."""
_MAX_HELD = 256
_MAX_ADDRESSES = 1024
"""Remembered addresses; the least recently used one is forgotten first."""


class TooManyGuesses(Exception):
    """The error for an address with too many secrets waiting to be compared."""


class _Allowance:
    """A token bucket."""

    def __init__(self, capacity: float, per_s: float, now: float) -> None:
        self._capacity, self._per_s = capacity, per_s
        self._level, self._updated = capacity, now

    def level(self, now: float) -> float:
        self._level = min(self._capacity, self._level + (now - self._updated) * self._per_s)
        self._updated = now
        return self._level

    def is_full(self, now: float) -> bool:
        return self.level(now) >= self._capacity

    def add(self, tokens: float) -> None:
        self._level += tokens


class GuessLimiter:
    """A comparison of secrets that is delayed for addresses that guess; used on one event loop."""

    def __init__(
        self,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], Awaitable[object]] = asyncio.sleep,
    ) -> None:
        self._clock, self._sleep = clock, sleep
        self._total = _Allowance(TOTAL_ALLOWANCE, TOTAL_ALLOWANCE_PER_S, clock())
        self._allowances: OrderedDict[str, _Allowance] = OrderedDict()
        self._held: Counter[str] = Counter()

    async def verify(self, host: str, is_valid: Callable[[], bool]) -> bool:
        """Return `is_valid()`, immediately or after HOLD_S; raise TooManyGuesses if too many are delayed.

        host: IP number of the visitor. is_valid: compares the visitor's secret in constant time.
        """
        network = network_of_address(host)
        allowance, now = self._allowance(network), self._clock()
        is_clean = allowance.is_full(now) and not self._held[network]
        if allowance.level(now) >= 1.0 and self._total.level(now) >= 1.0:
            # Subtracted before the comparison, so that simultaneous secrets do not share one allowance.
            for bucket in (allowance, self._total):
                bucket.add(-1.0)
            valid = is_valid()
            for bucket in (allowance, self._total) if valid else ():
                bucket.add(1.0)
            return valid
        # An address without an invalid secret is delayed, never refused, however many others guess.
        if not is_clean and (self._held[network] >= HELD_PER_ADDRESS or self._held.total() >= _MAX_HELD):
            raise TooManyGuesses
        self._held[network] += 1
        try:
            await self._sleep(HOLD_S)
        finally:
            self._held[network] -= 1
            if not self._held[network]:
                del self._held[network]
        valid = is_valid()
        if not valid and is_clean:
            allowance.add(-1.0)
        return valid

    def _allowance(self, network: str) -> _Allowance:
        if network not in self._allowances:
            self._allowances[network] = _Allowance(ALLOWANCE, ALLOWANCE_PER_S, self._clock())
            while len(self._allowances) > _MAX_ADDRESSES:
                self._allowances.popitem(last=False)
        self._allowances.move_to_end(network)
        return self._allowances[network]


def network_of_address(host: str) -> str:
    """Return what counts as one visitor: an IPv4 address, or the /64 network of an IPv6 address."""
    try:
        number = ipaddress.ip_address(host.partition("%")[0])
    except ValueError:
        return host
    if isinstance(number, ipaddress.IPv6Address):
        if number.ipv4_mapped is not None:
            return str(number.ipv4_mapped)
        return str(ipaddress.ip_network((number, 64), strict=False))
    return str(number)
