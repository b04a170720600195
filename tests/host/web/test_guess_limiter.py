"""The rate of guesses at a secret is limited, and the owner is not delayed by the guesses of others."""

import asyncio
import heapq
import itertools

import pytest

from hubodo.web import guess_limiter
from hubodo.web.guess_limiter import (
    ALLOWANCE,
    ALLOWANCE_PER_S,
    HELD_PER_ADDRESS,
    HOLD_S,
    TOTAL_ALLOWANCE,
    GuessLimiter,
    TooManyGuesses,
    network_of_address,
)
from hubodo.web.secrets import SESSION_LIFETIME_S, AccessSecrets

TOKEN = "correct-horse-battery"


class SimulatedClock:
    """A clock that advances when all tasks sleep."""

    def __init__(self):
        self.now, self._sleeping, self._numbers = 0.0, [], itertools.count()

    def __call__(self):
        return self.now

    async def sleep(self, seconds):
        awake = asyncio.get_running_loop().create_future()
        heapq.heappush(self._sleeping, (self.now + seconds, next(self._numbers), awake))
        await awake

    async def run_until(self, end):
        while True:
            for _ in range(10):
                await asyncio.sleep(0)
            if not self._sleeping or self._sleeping[0][0] > end:
                self.now = end
                return
            self.now, _, awake = heapq.heappop(self._sleeping)
            awake.set_result(None)


class Visitors:
    """A guess limiter with simulated visitors who guess or log in."""

    def __init__(self):
        self.time = SimulatedClock()
        self.limiter = GuessLimiter(self.time, self.time.sleep)
        self.compared = self.refused = 0
        self.tasks = []

    def compare_wrong_secret(self):
        self.compared += 1
        return False

    def guess_repeatedly(self, host):
        async def guess():
            while True:
                try:
                    await self.limiter.verify(host, self.compare_wrong_secret)
                except TooManyGuesses:
                    self.refused += 1
                    await self.time.sleep(0.2)

        self.tasks.append(asyncio.ensure_future(guess()))

    async def login_s(self, host):
        """Log in as the owner; return the delay in s, or None if the comparison is refused."""
        start, done = self.time.now, []

        async def login():
            try:
                done.append(await self.limiter.verify(host, lambda: True))
            except TooManyGuesses:
                done.append(None)

        task = asyncio.ensure_future(login())
        while not done:
            await self.time.run_until(self.time.now + 0.01)
        await task
        return self.time.now - start if done[0] else None


def run(scenario):
    """Run a scenario in a new event loop and cancel its visitors at the end."""

    async def run_and_cancel():
        visitors = Visitors()
        try:
            return await scenario(visitors)
        finally:
            for task in visitors.tasks:
                task.cancel()

    return asyncio.run(run_and_cancel())


@pytest.mark.parametrize("connections", [1, 60, 150])
def test_the_guesses_of_an_address_are_limited_whatever_its_number_of_connections(connections):
    async def scenario(visitors):
        for _ in range(connections):
            visitors.guess_repeatedly("192.0.2.1")
        await visitors.time.run_until(5.0)
        return visitors.compared, visitors.refused

    compared, refused = run(scenario)
    max_rate = min(connections, HELD_PER_ADDRESS) / HOLD_S + ALLOWANCE_PER_S
    assert compared <= 5.0 * max_rate + ALLOWANCE + 1
    assert (refused > 0) == (connections > HELD_PER_ADDRESS)


def test_beside_sixty_guessing_connections_of_one_address_its_owner_waits_one_hold_at_most():
    async def scenario(visitors):
        for _ in range(60):
            visitors.guess_repeatedly("192.0.2.1")
        waits = []
        for _ in range(30):
            await visitors.time.run_until(visitors.time.now + 0.37)
            waits.append(await visitors.login_s("192.0.2.1"))
        return waits

    waits = run(scenario)
    assert None not in waits
    assert max(waits) <= HOLD_S + 0.011 < 1.0


@pytest.mark.parametrize("n_guessing_hosts", [1, 10])
def test_an_owner_at_another_address_is_never_refused(n_guessing_hosts):
    async def scenario(visitors):
        for host in range(n_guessing_hosts):
            for _ in range(70):
                visitors.guess_repeatedly(f"192.0.2.{host}")
        await visitors.time.run_until(4.0)
        return [await visitors.login_s("198.51.100.1") for _ in range(3)]

    waits = run(scenario)
    assert None not in waits
    assert max(waits) <= (0.011 if n_guessing_hosts == 1 else HOLD_S + 0.011)


def test_guesses_from_many_addresses_are_limited_and_their_table_is_bounded(monkeypatch):
    monkeypatch.setattr(guess_limiter, "_MAX_ADDRESSES", 50)

    async def scenario(visitors):
        for host in range(200):
            for _ in range(3):
                visitors.guess_repeatedly(f"2001:db8:0:{host:x}::1")
        for _ in range(10):
            await asyncio.sleep(0)
        return visitors.compared, len(visitors.limiter._allowances)

    compared, remembered = run(scenario)
    assert compared == TOTAL_ALLOWANCE
    assert remembered == 50


def test_valid_secrets_do_not_use_the_allowance():
    async def scenario(visitors):
        waits = [await visitors.login_s("192.0.2.1") for _ in range(100)]
        return max(waits)

    assert run(scenario) <= 0.011


def test_visitors_are_counted_by_ipv4_address_or_ipv6_network():
    assert (
        network_of_address("192.0.2.1")
        == network_of_address("::ffff:192.0.2.1")
        != network_of_address("192.0.2.2")
    )
    assert (
        network_of_address("2001:db8::1")
        == network_of_address("2001:db8::ffff:1%eth0")
        != network_of_address("2001:db8:0:1::1")
    )
    assert network_of_address("testclient") == "testclient"


def test_a_session_ends_after_thirty_days_and_with_another_token():
    now = [1_700_000_000.0]
    access = AccessSecrets(TOKEN, lambda: now[0])
    session = access.begin_session()
    restarted = AccessSecrets(TOKEN, lambda: now[0])
    assert restarted.is_session(session) and restarted.is_known_session(session)
    assert not AccessSecrets("another-secret-token", lambda: now[0]).is_session(session)
    issued, nonce, mac = session.split(".")
    for forged in (
        f"{int(issued) + 1}.{nonce}.{mac}",
        f"{issued}.{nonce}0.{mac}",
        f"{issued}.{mac}",
        "",
        "..",
        "١.a.b",
    ):
        assert not restarted.is_session(forged), forged
    now[0] += SESSION_LIFETIME_S - 1
    assert restarted.is_session(session) and restarted.is_known_session(session)
    now[0] += 1
    assert not restarted.is_session(session) and not restarted.is_known_session(session)
    assert SESSION_LIFETIME_S <= 30 * 86_400


def test_a_session_that_was_ended_is_invalid_and_others_are_not():
    access = AccessSecrets(TOKEN)
    session, other = access.begin_session(), access.begin_session()
    access.end_session(session)
    assert not access.is_session(session) and not access.is_known_session(session)
    assert access.is_session(other)
