"""Type hashes of ROS 2 messages (REP 2011, RIHS01), computed from their definitions.

A type hash is the SHA-256 of the type description as JSON: its fields and those of all types that it
contains. Programs with other fields of the same type name then have another hash.
"""

from __future__ import annotations

import functools
import hashlib
import json
from typing import Any

from hubodo.log import ros2
from hubodo.ros2.names import full_name

_NESTED_TYPE = 1
_FIELD_TYPES = {
    "int8": 2,
    "uint8": 3,
    "int16": 4,
    "uint16": 5,
    "int32": 6,
    "uint32": 7,
    "int64": 8,
    "uint64": 9,
    "float32": 10,
    "float64": 11,
    "char": 3,
    "bool": 15,
    "byte": 16,
    "string": 17,
}
"""Numbers of type_description_interfaces/msg/FieldType; rosidl describes char as uint8."""
_ARRAY_TYPE, _UNBOUNDED_SEQUENCE = 48, 144
"""Added to the number of an element type."""


@functools.cache
def type_hash(message_type: str) -> str:
    """Return the hash of a message type, `RIHS01_` and 64 hexadecimal digits."""
    nested: dict[str, Any] = {}
    main = _describe(message_type, nested)
    text = json.dumps(
        {
            "type_description": main,
            "referenced_type_descriptions": [nested[name] for name in sorted(nested)],
        },
        separators=(", ", ": "),
    )
    return f"RIHS01_{hashlib.sha256(text.encode()).hexdigest()}"


def _describe(message_type: str, nested: dict[str, Any]) -> dict[str, Any]:
    """Return the description of a type, and add those of the types it contains to `nested`."""
    described = []
    for field in ros2.message_fields(message_type):
        number = _FIELD_TYPES.get(field.type, _NESTED_TYPE)
        nested_name = ""
        if number == _NESTED_TYPE:
            nested_name = full_name(field.type)
            if nested_name not in nested:
                nested[nested_name] = _describe(field.type, nested)
        if field.is_array:
            number += _UNBOUNDED_SEQUENCE if field.count is None else _ARRAY_TYPE
        field_type = {
            "type_id": number,
            "capacity": field.count if field.is_array and field.count is not None else 0,
            "string_capacity": 0,
            "nested_type_name": nested_name,
        }
        described.append({"name": field.name, "type": field_type})
    return {"type_name": full_name(message_type), "fields": described}
