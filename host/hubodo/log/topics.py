"""Topic names and metadata record names of a log, shared by writer and reader."""

from __future__ import annotations

from hubodo.recording import HIGH_G_SUFFIX
from hubodo.safe_text import json_text

HUBODO_PREFIX = "/hubodo/"
EVENTS = "/hubodo/events"
RAW_PREFIX = "/hubodo/raw/"
CLOCK_REQUEST_PREFIX = "/hubodo/asked/"
COLUMNS_PREFIX = "/hubodo/columns/"
HIGH_G_PREFIX = "high_g/"
"""Columns of a node's second accelerometer, after the prefix."""
WHEELS = "wheels"
"""Columns with the surface speeds of another odometer, after the prefix."""
ODOM = "/odom"
ODOM_MAP = "/odom_map"
TF = "/tf"
TF_STATIC = "/tf_static"
GNSS_FIX = "/gnss/fix"
NMEA = "/gnss/nmea"
TRUTH = "/truth"

METADATA_RECORD = "hubodo"
"""The main metadata record: fingerprint, versions, and additions of the recorder."""
CSV_COLUMNS_RECORD = "hubodo.csv"
"""Metadata record of an import: table name -> JSON list of its columns in order."""
NODE_RECORD_PREFIX = "node."
"""Metadata record of a node: this and its name."""
T_ZERO_KEY = "t_zero_ns"
"""Key in the main metadata record: host time of t = 0, ns."""

EVENT_JSON_SCHEMA = json_text(
    {
        "title": "hubodo/Event",
        "type": "object",
        "properties": {
            "t_ns": {"type": "integer"},
            "kind": {"type": "string"},
            "source": {"type": "string"},
            "text": {"type": "string"},
            "data": {"type": "object"},
        },
        "required": ["t_ns", "kind", "source", "text", "data"],
    }
)


def imu_topic(node: str) -> str:
    """Return the topic of a node's inertial samples."""
    return f"/{node}/imu"


def temperature_topic(node: str) -> str:
    """Return the topic of a node's temperature."""
    return f"/{node}/temperature"


def battery_topic(node: str) -> str:
    """Return the topic of a node's supply voltage."""
    return f"/{node}/battery"


def bias_filter_topic(node: str) -> str:
    """Return the topic of the gyro bias filter on a node."""
    return f"/{node}/bias_filter"


def magnetic_field_topic(node: str) -> str:
    """Return the topic of a node's magnetometer."""
    return f"/{node}/mag"


def columns_name(file: str) -> str:
    """Return the name of a file's columns, after the prefix, from its name in the CSV folder."""
    node = file.removesuffix(HIGH_G_SUFFIX)
    return file if node == file else HIGH_G_PREFIX + node
