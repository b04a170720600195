"""ROS 2 message types: their names, definitions and fields."""

from __future__ import annotations

import functools
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

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
