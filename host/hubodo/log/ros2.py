"""ROS 2 message definitions, and the CDR byte layouts derived from them.

CDR as ROS 2 writes it: 4 bytes of encapsulation (little-endian plain CDR), then the fields in order, each
aligned to its own size counted from the end of those 4 bytes. If all strings and sequences of a channel have
constant length, every message has the same size and numpy encodes and decodes whole batches.
"""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hubodo.safe_text import json_text

IMU = "sensor_msgs/msg/Imu"
MAGNETIC_FIELD = "sensor_msgs/msg/MagneticField"
TEMPERATURE = "sensor_msgs/msg/Temperature"
BATTERY = "sensor_msgs/msg/BatteryState"
NAV_SAT_FIX = "sensor_msgs/msg/NavSatFix"
ODOMETRY = "nav_msgs/msg/Odometry"
TF = "tf2_msgs/msg/TFMessage"
FLOAT64_ARRAY = "std_msgs/msg/Float64MultiArray"
UINT8_ARRAY = "std_msgs/msg/UInt8MultiArray"
STRING = "std_msgs/msg/String"
TWIST_STAMPED = "geometry_msgs/msg/TwistStamped"
TWIST_WITH_COVARIANCE_STAMPED = "geometry_msgs/msg/TwistWithCovarianceStamped"
JOINT_STATE = "sensor_msgs/msg/JointState"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
PARTICIPANT_ENTITIES = "rmw_dds_common/ParticipantEntitiesInfo"
HUMBLE_PARTICIPANT_ENTITIES = "rmw_dds_common/humble/ParticipantEntitiesInfo"

POSE_WITH_COVARIANCE_STAMPED = "geometry_msgs/msg/PoseWithCovarianceStamped"
EMPTY = "std_msgs/msg/Empty"
EMPTY_SERVICE = "std_srvs/srv/Empty"
TRIGGER_SERVICE = "std_srvs/srv/Trigger"
SET_POSE_SERVICE = "robot_localization/srv/SetPose"

UNKNOWN_VARIANCE = 1e6
"""m² or rad²: variance of a pose coordinate that was not measured; zero would mean exact."""
ENCAPSULATION = b"\x00\x01\x00\x00"
_NO_FIELDS = "uint8 structure_needs_at_least_one_member"
"""Definition of a message without fields in IDL."""


def _graph_definitions(package: str, id_bytes: int) -> dict[str, str]:
    """Return the definitions of the messages by which nodes announce their readers and writers."""
    return {
        f"{package}/Gid": f"char[{id_bytes}] data",
        f"{package}/NodeEntitiesInfo": (
            "string node_namespace\nstring node_name\n"
            f"{package}/Gid[] reader_gid_seq\n{package}/Gid[] writer_gid_seq"
        ),
        f"{package}/ParticipantEntitiesInfo": (
            f"{package}/Gid gid\n{package}/NodeEntitiesInfo[] node_entities_info_seq"
        ),
    }


# Fields as in the .msg files of common_interfaces, geometry2 and rcl_interfaces (ROS 2 Humble).
_DEFINITIONS: Mapping[str, str] = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
    "geometry_msgs/TwistWithCovariance": "geometry_msgs/Twist twist\nfloat64[36] covariance",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
    "geometry_msgs/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform"
    ),
    "sensor_msgs/NavSatStatus": (
        "int8 STATUS_NO_FIX=-1\nint8 STATUS_FIX=0\nint8 STATUS_SBAS_FIX=1\nint8 STATUS_GBAS_FIX=2\n"
        "uint16 SERVICE_GPS=1\nuint16 SERVICE_GLONASS=2\nuint16 SERVICE_COMPASS=4\nuint16 SERVICE_GALILEO=8\n"
        "int8 status\nuint16 service"
    ),
    "std_msgs/MultiArrayDimension": "string label\nuint32 size\nuint32 stride",
    "std_msgs/MultiArrayLayout": "std_msgs/MultiArrayDimension[] dim\nuint32 data_offset",
    IMU: (
        "std_msgs/Header header\ngeometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n"
        "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n"
        "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance"
    ),
    MAGNETIC_FIELD: (
        "std_msgs/Header header\ngeometry_msgs/Vector3 magnetic_field\nfloat64[9] magnetic_field_covariance"
    ),
    TEMPERATURE: "std_msgs/Header header\nfloat64 temperature\nfloat64 variance",
    BATTERY: (
        "uint8 POWER_SUPPLY_STATUS_UNKNOWN=0\nuint8 POWER_SUPPLY_STATUS_CHARGING=1\n"
        "uint8 POWER_SUPPLY_STATUS_DISCHARGING=2\nuint8 POWER_SUPPLY_STATUS_NOT_CHARGING=3\n"
        "uint8 POWER_SUPPLY_STATUS_FULL=4\n"
        "uint8 POWER_SUPPLY_HEALTH_UNKNOWN=0\nuint8 POWER_SUPPLY_HEALTH_GOOD=1\n"
        "uint8 POWER_SUPPLY_HEALTH_OVERHEAT=2\nuint8 POWER_SUPPLY_HEALTH_DEAD=3\n"
        "uint8 POWER_SUPPLY_HEALTH_OVERVOLTAGE=4\nuint8 POWER_SUPPLY_HEALTH_UNSPEC_FAILURE=5\n"
        "uint8 POWER_SUPPLY_HEALTH_COLD=6\nuint8 POWER_SUPPLY_HEALTH_WATCHDOG_TIMER_EXPIRE=7\n"
        "uint8 POWER_SUPPLY_HEALTH_SAFETY_TIMER_EXPIRE=8\n"
        "uint8 POWER_SUPPLY_TECHNOLOGY_UNKNOWN=0\nuint8 POWER_SUPPLY_TECHNOLOGY_NIMH=1\n"
        "uint8 POWER_SUPPLY_TECHNOLOGY_LION=2\nuint8 POWER_SUPPLY_TECHNOLOGY_LIPO=3\n"
        "uint8 POWER_SUPPLY_TECHNOLOGY_LIFE=4\nuint8 POWER_SUPPLY_TECHNOLOGY_NICD=5\n"
        "uint8 POWER_SUPPLY_TECHNOLOGY_LIMN=6\n"
        "std_msgs/Header header\nfloat32 voltage\nfloat32 temperature\nfloat32 current\nfloat32 charge\n"
        "float32 capacity\nfloat32 design_capacity\nfloat32 percentage\nuint8 power_supply_status\n"
        "uint8 power_supply_health\nuint8 power_supply_technology\nbool present\nfloat32[] cell_voltage\n"
        "float32[] cell_temperature\nstring location\nstring serial_number"
    ),
    NAV_SAT_FIX: (
        "uint8 COVARIANCE_TYPE_UNKNOWN=0\nuint8 COVARIANCE_TYPE_APPROXIMATED=1\n"
        "uint8 COVARIANCE_TYPE_DIAGONAL_KNOWN=2\nuint8 COVARIANCE_TYPE_KNOWN=3\n"
        "std_msgs/Header header\nsensor_msgs/NavSatStatus status\n"
        "float64 latitude\nfloat64 longitude\nfloat64 altitude\n"
        "float64[9] position_covariance\nuint8 position_covariance_type"
    ),
    ODOMETRY: (
        "std_msgs/Header header\nstring child_frame_id\n"
        "geometry_msgs/PoseWithCovariance pose\ngeometry_msgs/TwistWithCovariance twist"
    ),
    TF: "geometry_msgs/TransformStamped[] transforms",
    FLOAT64_ARRAY: "std_msgs/MultiArrayLayout layout\nfloat64[] data",
    UINT8_ARRAY: "std_msgs/MultiArrayLayout layout\nuint8[] data",
    STRING: "string data",
    TWIST_STAMPED: "std_msgs/Header header\ngeometry_msgs/Twist twist",
    TWIST_WITH_COVARIANCE_STAMPED: "std_msgs/Header header\ngeometry_msgs/TwistWithCovariance twist",
    JOINT_STATE: (
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort"
    ),
    POSE_WITH_COVARIANCE_STAMPED: "std_msgs/Header header\ngeometry_msgs/PoseWithCovariance pose",
    EMPTY: _NO_FIELDS,
    f"{EMPTY_SERVICE}_Request": _NO_FIELDS,
    f"{EMPTY_SERVICE}_Response": _NO_FIELDS,
    f"{TRIGGER_SERVICE}_Request": _NO_FIELDS,
    f"{TRIGGER_SERVICE}_Response": "bool success\nstring message",
    f"{SET_POSE_SERVICE}_Request": f"{POSE_WITH_COVARIANCE_STAMPED} pose",
    f"{SET_POSE_SERVICE}_Response": _NO_FIELDS,
    "service_msgs/ServiceEventInfo": (
        "uint8 REQUEST_SENT=0\nuint8 REQUEST_RECEIVED=1\nuint8 RESPONSE_SENT=2\nuint8 RESPONSE_RECEIVED=3\n"
        "uint8 event_type\nbuiltin_interfaces/Time stamp\nchar[16] client_gid\nint64 sequence_number"
    ),
    "diagnostic_msgs/KeyValue": "string key\nstring value",
    "diagnostic_msgs/DiagnosticStatus": (
        "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\n"
        "byte level\nstring name\nstring message\nstring hardware_id\ndiagnostic_msgs/KeyValue[] values"
    ),
    DIAGNOSTICS: "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status",
    **_graph_definitions("rmw_dds_common", 16),
    # ROS 2 Humble has the same type names with longer identifiers.
    **_graph_definitions("rmw_dds_common/humble", 24),
}

STAMPED_TYPES = frozenset(
    {IMU, MAGNETIC_FIELD, TEMPERATURE, BATTERY, NAV_SAT_FIX, ODOMETRY, JOINT_STATE}
    | {TWIST_STAMPED, TWIST_WITH_COVARIANCE_STAMPED}
)
"""Types that begin with a header, whose stamp is in bytes 4 to 12 of each message."""

_PRIMITIVES: Mapping[str, str] = {
    "bool": "b1",
    "byte": "u1",
    "char": "u1",
    "int8": "i1",
    "uint8": "u1",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "float32": "f4",
    "float64": "f8",
}
_FIELD = re.compile(r"^(?P<type>[\w/]+)(?P<array>\[(?P<count>\d*)\])? (?P<name>[a-z]\w*)$")


@dataclass(frozen=True)
class Field:
    """One line of a definition; count is 1 for a scalar, None for an unbounded sequence."""

    type: str
    name: str
    count: int | None
    is_array: bool


@functools.cache
def message_fields(name: str) -> tuple[Field, ...]:
    """Return the fields of a message type in order, without constants."""
    message = []
    for line in _DEFINITIONS[name].splitlines():
        match = _FIELD.match(line)
        if match is None:
            continue
        count = None if match["array"] and not match["count"] else int(match["count"] or 1)
        message.append(Field(match["type"], match["name"], count, bool(match["array"])))
    return tuple(message)


@functools.cache
def definition(name: str) -> str:
    """Return the text of an MCAP schema of encoding `ros2msg`: the message type and its dependencies."""
    parts = list(dict.fromkeys(_dependencies(name)))
    blocks = [_DEFINITIONS[name], *(f"MSG: {part}\n{_DEFINITIONS[part]}" for part in parts)]
    return ("\n" + "=" * 80 + "\n").join(blocks) + "\n"


def _dependencies(name: str) -> Iterator[str]:
    for field in message_fields(name):
        if field.type in _DEFINITIONS:
            yield field.type
            yield from _dependencies(field.type)


@dataclass(frozen=True)
class CdrLayout:
    """The byte layout of one message type for given string and sequence lengths.

    Attributes
    ----------
    dtype : structured, little-endian; its itemsize is the message with encapsulation. Field names are dotted
        paths (`header.stamp.sec`); a group of float64 also has its own name (`angular_velocity`, shape (3,)).
    template : () record of that dtype with encapsulation, strings and lengths set, all else zero.
    """

    dtype: np.dtype[np.void]
    template: np.ndarray[tuple[()], np.dtype[np.void]]


class _LayoutBuilder:
    """A builder that places the fields of a definition; `length_of(path, position)` returns lengths."""

    def __init__(self, length_of: Callable[[str, int], int], byte_order: str = "<") -> None:
        self.length_of, self.byte_order = length_of, byte_order
        self.position = len(ENCAPSULATION)
        self.names: list[str] = []
        self.formats: list[object] = []
        self.offsets: list[int] = []
        self.lengths: dict[str, int] = {}

    def add_field(self, path: str, code: str, count: int = 1, *, is_array: bool = False) -> None:
        size = int(code[1:])
        if count:
            self.position += -(self.position - len(ENCAPSULATION)) % size
        self._record_field(
            path, (self.byte_order + code, (count,)) if is_array else self.byte_order + code, self.position
        )
        self.position += size * count

    def _record_field(self, path: str, form: object, offset: int) -> None:
        self.names.append(path)
        self.formats.append(form)
        self.offsets.append(offset)

    def _add_length(self, path: str) -> int:
        self.add_field(path + ".length", "u4")
        length = self.lengths[path + ".length"] = self.length_of(path, self.position - 4)
        return length

    def add_message(self, name: str, prefix: str) -> None:
        for field in message_fields(name):
            path = prefix + field.name
            count = self._add_length(path) if field.count is None else field.count
            if field.type == "string":
                length = self._add_length(path)
                self._record_field(path, f"V{length}", self.position)
                self.position += length
            elif field.type in _PRIMITIVES:
                self.add_field(path, _PRIMITIVES[field.type], count, is_array=field.is_array)
            else:
                for i in range(count):
                    self._add_group(field.type, f"{path}[{i}]" if field.is_array else path)

    def _add_group(self, name: str, path: str) -> None:
        first = len(self.names)
        self.add_message(name, path + ".")
        if all(form == self.byte_order + "f8" for form in self.formats[first:]):
            self._record_field(
                path, (self.byte_order + "f8", (len(self.names) - first,)), self.offsets[first]
            )

    def dtype(self) -> np.dtype[np.void]:
        return np.dtype(
            {
                "names": ["encapsulation", *self.names],
                "formats": ["<u4", *self.formats],
                "offsets": [0, *self.offsets],
                "itemsize": self.position,
            }
        )


def cdr_layout(
    name: str, texts: Mapping[str, bytes] | None = None, lengths: Mapping[str, int] | None = None
) -> CdrLayout:
    """Return the byte layout of one message type.

    texts: value of each string field by path, without the terminating zero. lengths: number of elements of
    each sequence. Raises KeyError if a string or sequence is missing.
    """
    closed = {path: text + b"\x00" for path, text in (texts or {}).items()}
    known = {**(lengths or {}), **{path: len(text) for path, text in closed.items()}}
    builder = _LayoutBuilder(lambda path, _: known[path])
    builder.add_message(name, "")
    template = np.zeros((), builder.dtype())
    template["encapsulation"] = int.from_bytes(ENCAPSULATION, "little")
    for path, length in builder.lengths.items():
        template[path] = length
    for path, text in closed.items():
        if path in builder.names:
            template[path] = np.void(text)
    return CdrLayout(builder.dtype(), template)


@dataclass(frozen=True)
class ReceivedLayout:
    """The layout of a received message.

    dtype: structure of the message. lengths: value of each length field, which other messages of this layout
    share.
    """

    dtype: np.dtype[np.void]
    lengths: Mapping[str, int]
    encapsulation: int

    def element_count(self, path: str) -> int:
        """Return the number of elements of a field."""
        assert self.dtype.fields is not None
        return math.prod(self.dtype.fields[path][0].shape)

    def read_string(self, payload: bytes, path: str) -> str:
        """Return a string field of a message of this layout."""
        assert self.dtype.fields is not None
        part, offset = self.dtype.fields[path][:2]
        return payload[offset : offset + part.itemsize].rstrip(b"\0").decode("utf-8", "replace")


def infer_layout(name: str, payload: bytes) -> ReceivedLayout:
    """Infer the layout of one message from the string and sequence lengths in its bytes.

    Raises ValueError for an encapsulation other than plain CDR and for lengths that do not match the payload.
    """
    if payload[:2] not in (b"\x00\x00", b"\x00\x01"):
        raise ValueError(f"encapsulation {payload[:4].hex()} is not plain CDR")
    order: Literal["little", "big"] = "little" if payload[1] else "big"

    def length_of(path: str, position: int) -> int:
        length = int.from_bytes(payload[position : position + 4], order)
        if position + 4 + length > len(payload):
            raise ValueError(f"{path} claims {length} elements in a message of {len(payload)} bytes")
        return length

    builder = _LayoutBuilder(length_of, "<" if payload[1] else ">")
    builder.add_message(name, "")
    if not builder.position <= len(payload) <= builder.position + 3:
        raise ValueError(f"message of {len(payload)} bytes should have {builder.position}")
    return ReceivedLayout(builder.dtype(), builder.lengths, int.from_bytes(payload[:4], "little"))


def stamped_layout(name: str, frame_id: str, child_frame_id: str = "") -> CdrLayout:
    """Return the layout of a message with one header (or one transform) and constant frame names.

    The cells, location and serial number of a BatteryState stay empty.
    """
    prefix = "transforms[0]." if name == TF else ""
    texts = {
        prefix + "header.frame_id": frame_id.encode(),
        prefix + "child_frame_id": child_frame_id.encode(),
        "location": b"",
        "serial_number": b"",
    }
    return cdr_layout(name, texts, {"transforms": 1, "cell_voltage": 0, "cell_temperature": 0})


def columns_layout(names: Sequence[str]) -> CdrLayout:
    """Return the layout of a row of numbers as a Float64MultiArray with the column names as label.

    The label keeps the names in copies by other programs, which drop the metadata of channels.
    """
    label, count = json_text(list(names)).encode(), len(names)
    row_layout = cdr_layout(FLOAT64_ARRAY, {"layout.dim[0].label": label}, {"layout.dim": 1, "data": count})
    row_layout.template["layout.dim[0].size"] = count
    row_layout.template["layout.dim[0].stride"] = count
    return row_layout
