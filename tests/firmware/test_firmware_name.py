"""Names asked for by the node itself: queries that a name server reads, replies read or refused."""

import random

import pytest
from name import answer, is_address, question

from hubodo.emulator.board.network import WifiEnvironment

AIR = WifiEnvironment(dns_records=((0.0, "laptop.lan", "192.168.1.77"),))


def test_the_address_in_a_reply_behind_another_name_is_found():
    query = question("laptop.lan", 0xBEEF)
    assert answer(AIR.answer_dns(0.0, query), query) == "192.168.1.77"


def test_a_query_is_the_bytes_of_rfc_1035():
    """Written down by hand from section 4.1."""
    assert question("a.bc", 0x0102) == bytes.fromhex(
        "0102 0100 0001 0000 0000 0000 01 61 02 6263 00 0001 0001"
    )


@pytest.mark.parametrize(
    "reply",
    [
        b"",
        b"\xbe\xef",
        AIR.answer_dns(0.0, question("laptop.lan", 0xBEF0)),
        AIR.answer_dns(0.0, question("other.lan", 0xBEEF)),
        question("laptop.lan", 0xBEEF),
        AIR.answer_dns(0.0, question("laptop.lan", 0xBEEF))[:-1],
    ],
    ids=["nothing", "two bytes", "another number", "no such name", "the query itself", "cut"],
)
def test_what_is_no_answer_is_none(reply):
    assert answer(reply, question("laptop.lan", 0xBEEF)) is None


def test_damaged_replies_never_raise_and_never_hang():
    query, rng = question("laptop.lan", 0xBEEF), random.Random(5)
    whole = AIR.answer_dns(0.0, query)
    for _ in range(5000):
        damaged = bytearray(whole[: rng.randrange(len(whole) + 1)])
        for _ in range(rng.randrange(4)):
            if len(damaged) > 2:
                damaged[rng.randrange(2, len(damaged))] = rng.randrange(256)
        address = answer(bytes(damaged), query)
        assert address is None or is_address(address)


@pytest.mark.parametrize(
    ("host", "known"),
    [("192.168.1.5", True), ("laptop.lan", False), ("", False), ("1.2.3", False), ("1.2.3.x", False)],
)
def test_addresses_are_not_asked_for(host, known):
    assert is_address(host) == known
