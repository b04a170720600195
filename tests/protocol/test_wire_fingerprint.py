"""The fingerprint changes with everything that changes the meaning of the bytes."""

import dataclasses
from enum import IntEnum
from typing import ClassVar

import pytest

from hubowire import FINGERPRINT, MESSAGES, Message
from hubowire.fingerprint import canonical_text, fingerprint
from hubowire.messages import ENUMS, wire_fields

FIELDS = [(kind, row.name) for kind in MESSAGES for row in wire_fields(kind)]


def of(messages: tuple, enums: tuple = ENUMS) -> int:
    return fingerprint(canonical_text(messages, enums))


def rebuilt(kind: type[Message], **change: dict) -> type[Message]:
    """Return the message class with another name, id, or metadata of one field."""
    rows = []
    for item in dataclasses.fields(kind):
        meta = dict(item.metadata) | change.get(item.name, {})
        name = meta.pop("name", item.name)
        rows.append((name, item.type, dataclasses.field(metadata=meta)))
    changed_class = dataclasses.make_dataclass(kind.__name__, rows, bases=(Message,), frozen=True)
    changed_class.type_id = kind.type_id
    return changed_class


def swapped(old: type[Message], new: type[Message]) -> tuple:
    return tuple(new if kind is old else kind for kind in MESSAGES)


def test_an_unchanged_table_has_the_same_fingerprint():
    assert of(tuple(rebuilt(kind) for kind in MESSAGES)) == FINGERPRINT


@pytest.mark.parametrize(("kind", "field"), FIELDS, ids=lambda value: getattr(value, "__name__", value))
def test_any_name_type_scale_or_unit_changes_it(kind: type[Message], field: str):
    for change in ({"name": "other"}, {"type": "7q"}, {"scale": "1e-29"}, {"unit": "furlong"}):
        assert of(swapped(kind, rebuilt(kind, **{field: change}))) != FINGERPRINT, change


def test_descriptions_do_not_change_the_fingerprint():
    kind, field = FIELDS[0]
    assert of(swapped(kind, rebuilt(kind, **{field: {"doc": "said otherwise"}}))) == FINGERPRINT


@pytest.mark.parametrize("kind", MESSAGES, ids=lambda kind: kind.__name__)
def test_the_code_the_name_the_presence_and_the_field_order_of_a_message_change_it(kind: type[Message]):
    other_code = rebuilt(kind)
    other_code.type_id = 0x7F
    other_name = rebuilt(kind)
    other_name.__name__ = "Other"
    for changed in (other_code, other_name):
        assert of(swapped(kind, changed)) != FINGERPRINT
    assert of(tuple(item for item in MESSAGES if item is not kind)) != FINGERPRINT


@pytest.mark.parametrize("enum", ENUMS, ids=lambda enum: enum.__name__)
def test_any_code_of_an_enum_changes_it(enum: type[IntEnum]):
    for name in enum.__members__:
        codes = {item.name: item.value for item in enum}
        renamed = {("OTHER_NAME" if key == name else key): value for key, value in codes.items()}
        for changed in (codes | {name: 99}, codes | {"NEW": 98}, renamed):
            changed_class = IntEnum(enum.__name__, changed)
            assert (
                of(MESSAGES, tuple(changed_class if item is enum else item for item in ENUMS)) != FINGERPRINT
            )


def test_the_text_has_no_class_variables_in_it():
    @dataclasses.dataclass(frozen=True)
    class Empty(Message):
        type_id: ClassVar[int] = 0x7E

    assert canonical_text((Empty,), ()) == "message 126 Empty"
