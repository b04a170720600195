"""Encoding and decoding of messages, over their whole range and beyond it."""

import dataclasses
from typing import ClassVar

import pytest
from hypothesis import given
from hypothesis import strategies as st
from wire_strategies import message, messages

from hubowire import MAX_PAYLOAD, MESSAGES, Message, PayloadError, decode, encode, hello_identity
from hubowire.codec import payload_layout
from hubowire.messages import Ack, Hello, ImuBatch, Mag, TimeRequest, declare_field, wire_fields


@given(messages)
def test_every_message_round_trips_and_fits_a_frame(sent: Message):
    payload = encode(sent)
    assert decode(sent.type_id, payload) == sent
    assert len(payload) <= MAX_PAYLOAD


@given(messages)
def test_a_payload_cut_anywhere_is_refused_and_names_its_message(sent: Message):
    payload = encode(sent)
    for end in range(len(payload)):
        with pytest.raises(PayloadError, match=type(sent).__name__):
            decode(sent.type_id, payload[:end])


@given(messages, st.binary(max_size=40))
def test_bytes_of_a_newer_version_are_passed_over(sent: Message, more: bytes):
    assert decode(sent.type_id, encode(sent) + more) == sent


@given(st.integers(0, 255), st.binary(max_size=MAX_PAYLOAD))
def test_any_payload_is_a_message_or_a_payload_error_or_unknown(type_id: int, payload: bytes):
    known = {kind.type_id: kind for kind in MESSAGES}
    try:
        decoded = decode(type_id, payload)
    except PayloadError:
        assert type_id in known
    else:
        assert decoded is None if type_id not in known else payload.startswith(encode(decoded))


@pytest.mark.parametrize(
    "wrong",
    [
        Mag(2**32, (0, 0, 0)),
        Mag(-1, (0, 0, 0)),
        Mag(0, (0, 0, 32768)),
        Mag(0, (0, 0)),
        Mag(0, 5),
        Mag(0.5, (0, 0, 0)),
        TimeRequest(b"seven b"),
        TimeRequest(b"nine byte"),
        ImuBatch(0, 0, 0, 0, 0, ((1, 2, 3),)),
        ImuBatch(0, 0, 0, 0, 0, ((0,) * 6,) * 256),
    ],
    ids=str,
)
def test_a_value_that_does_not_fit_is_refused_and_never_cut(wrong: Message):
    with pytest.raises(PayloadError, match=type(wrong).__name__):
        encode(wrong)


@given(message(Hello), st.binary(max_size=20))
def test_the_identity_of_any_hello_can_be_read(hello: Hello, more: bytes):
    expected = (hello.fingerprint, hello.firmware)
    assert hello_identity(encode(hello) + more) == expected
    assert hello_identity(encode(hello)[:7]) == expected


def test_a_missing_identity_is_refused():
    with pytest.raises(PayloadError, match="needs 7 bytes, 6 came"):
        hello_identity(bytes(6))


def test_hello_begins_with_seven_bytes_of_identity():
    first, second = wire_fields(Hello)[:2]
    assert (first.name, first.type, second.name, second.type) == ("fingerprint", "I", "firmware", "3B")


def test_a_field_after_a_counted_table_is_refused():
    @dataclasses.dataclass(frozen=True, slots=True)
    class Wrong(Message):
        type_id: ClassVar[int] = 0x70
        rows: tuple[tuple[int, ...], ...] = declare_field("2H[]", "rows")
        after: int = declare_field("B", "after the rows")

    with pytest.raises(TypeError, match="last field"):
        payload_layout(Wrong)


def test_type_ids_are_unique_and_the_direction_is_bit_six():
    ids = [kind.type_id for kind in MESSAGES]
    assert len(set(ids)) == len(ids)
    assert 0x3F not in ids
    assert decode(0x3F, b"") is None
    assert Ack.type_id < 0x40 <= TimeRequest.type_id


def test_every_message_class_is_in_the_table():
    there = {kind.__name__ for kind in Message.__subclasses__() if kind.__module__ == Message.__module__}
    assert there == {kind.__name__ for kind in MESSAGES}
