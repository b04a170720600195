"""Name resolution by the node: queries, valid and invalid replies."""

import random

import pytest
from name import answer, is_address, question

from hubodo.emulator.board.network import WifiEnvironment

NETWORK = WifiEnvironment(dns_records=((0.0, "laptop.lan", "192.168.1.77"),))


def test_the_address_is_found_in_a_reply_with_an_alias():
    query = question("laptop.lan", 0xBEEF)
    assert answer(NETWORK.answer_dns(0.0, query), query) == "192.168.1.77"


def test_a_query_has_the_bytes_of_rfc_1035():
    """The expected bytes are written by hand from section 4.1."""
    assert question("a.bc", 0x0102) == bytes.fromhex(
        "0102 0100 0001 0000 0000 0000 01 61 02 6263 00 0001 0001"
    )


@pytest.mark.parametrize(
    "reply",
    [
        b"",
        b"\xbe\xef",
        NETWORK.answer_dns(0.0, question("laptop.lan", 0xBEF0)),
        NETWORK.answer_dns(0.0, question("other.lan", 0xBEEF)),
        question("laptop.lan", 0xBEEF),
        NETWORK.answer_dns(0.0, question("laptop.lan", 0xBEEF))[:-1],
    ],
    ids=["nothing", "two bytes", "another number", "no such name", "the query itself", "cut"],
)
def test_invalid_replies_give_no_address(reply):
    assert answer(reply, question("laptop.lan", 0xBEEF)) is None


def test_damaged_replies_raise_no_exception_and_do_not_hang():
    query, rng = question("laptop.lan", 0xBEEF), random.Random(5)
    reply = NETWORK.answer_dns(0.0, query)
    for _ in range(5000):
        damaged = bytearray(reply[: rng.randrange(len(reply) + 1)])
        for _ in range(rng.randrange(4)):
            if len(damaged) > 2:
                damaged[rng.randrange(2, len(damaged))] = rng.randrange(256)
        address = answer(bytes(damaged), query)
        assert address is None or is_address(address)


@pytest.mark.parametrize(
    ("host", "expected"),
    [("192.168.1.5", True), ("laptop.lan", False), ("", False), ("1.2.3", False), ("1.2.3.x", False)],
)
def test_addresses_are_distinguished_from_names(host, expected):
    assert is_address(host) == expected
