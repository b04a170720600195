"""The rate at which secrets can be guessed: one limit for every way in, by the address of the visitor.

A wrong secret uses up an allowance of its address. An address that has none left is still served: each of
its secrets is compared only after HOLD_S, at most HELD_PER_ADDRESS at once, the others are refused unread.
So an address gets HELD_PER_ADDRESS / HOLD_S guesses a second, whatever it does with its connections, and an
owner behind the same address waits for HOLD_S, not for the guesses of others.

Neither can be lower without the other: a server that accepts its owner within 1 s, and cannot tell the owner
from N visitors of the same address, must compare the secrets of all of them within that second.
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
"""Wrong secrets that an address may send before it is held, and what it gets back."""
TOTAL_ALLOWANCE, TOTAL_ALLOWANCE_PER_S = 64.0, 4.0
"""The same for all addresses together: many of them that guess a few times each are held as well."""
_MOST_HELD = 256
_MOST_ADDRESSES = 1024
"""Allowances that are remembered; the one that was used longest ago is forgotten first."""


class TooManyGuesses(Exception):
    """The address has too many secrets waiting to be compared."""


class _Allowance:
    """A token bucket."""

    def __init__(self, most: float, per_s: float, now: float) -> None:
        self._most, self._per_s = most, per_s
        self._level, self._when = most, now

    def level(self, now: float) -> float:
        self._level = min(self._most, self._level + (now - self._when) * self._per_s)
        self._when = now
        return self._level

    def is_full(self, now: float) -> bool:
        return self.level(now) >= self._most

    def add(self, tokens: float) -> None:
        self._level += tokens


class GuessLimiter:
    """Compares secrets, each when its address may have one compared; used on one event loop alone."""

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
        """Return `is_valid()`, at once or after HOLD_S. Raises TooManyGuesses where too many are held.

        Parameters
        ----------
        host : IP number of the visitor.
        is_valid : compares what the visitor sent, in constant time.
        """
        network = network_of(host)
        allowance, now = self._allowance(network), self._clock()
        clean = allowance.is_full(now) and not self._held[network]
        if allowance.level(now) >= 1.0 and self._total.level(now) >= 1.0:
            # Taken before the comparison, so that secrets sent at once do not share one allowance.
            for bucket in (allowance, self._total):
                bucket.add(-1.0)
            valid = is_valid()
            for bucket in (allowance, self._total) if valid else ():
                bucket.add(1.0)
            return valid
        # An address without a wrong secret is held, never refused, however many others guess.
        if not clean and (self._held[network] >= HELD_PER_ADDRESS or self._held.total() >= _MOST_HELD):
            raise TooManyGuesses
        self._held[network] += 1
        try:
            await self._sleep(HOLD_S)
        finally:
            self._held[network] -= 1
            if not self._held[network]:
                del self._held[network]
        valid = is_valid()
        if not valid and clean:
            allowance.add(-1.0)
        return valid

    def _allowance(self, network: str) -> _Allowance:
        if network not in self._allowances:
            self._allowances[network] = _Allowance(ALLOWANCE, ALLOWANCE_PER_S, self._clock())
            while len(self._allowances) > _MOST_ADDRESSES:
                self._allowances.popitem(last=False)
        self._allowances.move_to_end(network)
        return self._allowances[network]


def network_of(host: str) -> str:
    """Return what counts as one visitor: an IPv4 number, or the /64 of an IPv6 number."""
    try:
        number = ipaddress.ip_address(host.partition("%")[0])
    except ValueError:
        return host
    if isinstance(number, ipaddress.IPv6Address):
        if number.ipv4_mapped is not None:
            return str(number.ipv4_mapped)
        return str(ipaddress.ip_network((number, 64), strict=False))
    return str(number)
