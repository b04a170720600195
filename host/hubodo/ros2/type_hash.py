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
_ARRAY_TYPE, _BOUNDED_SEQUENCE, _UNBOUNDED_SEQUENCE = 48, 96, 144
"""Added to the number of an element type."""
_EVENT_INFO = "service_msgs/ServiceEventInfo"


@functools.cache
def type_hash(message_type: str) -> str:
    """Return the hash of a message type, `RIHS01_` and 64 hexadecimal digits."""
    nested: dict[str, Any] = {}
    return _hash(_describe(message_type, nested), nested)


@functools.cache
def service_hash(service_type: str) -> str:
    """Return the hash of a service type, of which request, response and event are members."""
    nested: dict[str, Any] = {}
    request, response, event = (f"{service_type}_{part}" for part in ("Request", "Response", "Event"))
    for part in (request, response, _EVENT_INFO):
        nested[full_name(part)] = _describe(part, nested)
    fields = [_member("info", _EVENT_INFO)]
    fields += [
        _member(name, part, is_optional=True) for name, part in (("request", request), ("response", response))
    ]
    nested[event] = {"type_name": event, "fields": fields}
    members = (("request_message", request), ("response_message", response), ("event_message", event))
    return _hash({"type_name": service_type, "fields": [_member(*member) for member in members]}, nested)


def _member(name: str, nested_name: str, *, is_optional: bool = False) -> dict[str, Any]:
    """Return the description of a field that is a message; is_optional: as a sequence of at most one."""
    field_type = {
        "type_id": _NESTED_TYPE + (_BOUNDED_SEQUENCE if is_optional else 0),
        "capacity": int(is_optional),
        "string_capacity": 0,
        "nested_type_name": full_name(nested_name),
    }
    return {"name": name, "type": field_type}


def _hash(main: dict[str, Any], nested: dict[str, Any]) -> str:
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
