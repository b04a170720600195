"""DDS types of ROS 2 messages and services, as classes of Cyclone DDS whose instances hold encoded bytes."""

from __future__ import annotations

import functools
from typing import Any

from cyclonedds.idl import make_idl_struct, types

from hubodo.log import ros2
from hubodo.ros2.names import dds_type

REQUEST_ID = slice(4, 20)
"""Bytes of a request or reply of rmw_cyclonedds, after the encapsulation, that name the request: the client's
identifier and the number of the request. They precede the fields, whose alignment they leave unchanged."""

_ELEMENT_TYPES: dict[str, Any] = {
    "bool": bool,
    "byte": types.uint8,
    "char": types.uint8,
    "int8": types.int8,
    "uint8": types.uint8,
    "uint16": types.uint16,
    "int32": types.int32,
    "uint32": types.uint32,
    "float32": types.float32,
    "float64": types.float64,
    "string": str,
}
_REQUEST_ID_FIELDS = {"client_guid": types.uint64, "sequence_number": types.int64}


@functools.cache
def message_class(message_type: str, *, is_service: bool = False) -> Any:
    """Return a class with the DDS type of a message whose instances hold its bytes as `payload`.

    is_service: the message is a request or reply, with the identifier of the request before its fields.
    """
    encoded_class = _type_class(message_type, is_service)

    def serialize(self: Any, *_: object, **__: object) -> bytes:
        payload: bytes = self.payload
        return payload

    def deserialize(cls: Any, data: bytes, /, *_: object, **__: object) -> Any:
        message = object.__new__(cls)
        message.payload = bytes(data)
        return message

    encoded_class.serialize, encoded_class.deserialize = serialize, classmethod(deserialize)
    return encoded_class


@functools.cache
def _type_class(message_type: str, has_request_id: bool = False) -> Any:
    """Return the DDS type of a message."""
    members: dict[str, Any] = dict(_REQUEST_ID_FIELDS) if has_request_id else {}
    for field in ros2.message_fields(message_type):
        member = _ELEMENT_TYPES.get(field.type) or _type_class(field.type)
        if field.is_array:
            member = types.sequence[member] if field.count is None else types.array[member, field.count]
        members[field.name] = member
    name = dds_type(message_type)
    return make_idl_struct(name.replace("::", "_"), name, members)
