"""Topic names and the names of metadata records in a log: said once, for writer and reader."""

from __future__ import annotations

from hubodo.safe_text import json_text

OWN = "/hubodo/"
EVENTS = "/hubodo/events"
RAW = "/hubodo/raw/"
ASKED = "/hubodo/asked/"
COLUMNS = "/hubodo/columns/"
ODOM = "/odom"
ODOM_MAP = "/odom_map"
TF = "/tf"
TF_STATIC = "/tf_static"
FIX = "/gnss/fix"
TRUTH = "/truth"

METADATA = "hubodo"
"""The main metadata record: fingerprint, versions, and whatever the daemon adds."""
CSV_FILES = "hubodo.csv"
"""Metadata record of an import: file name without suffix -> JSON list of its columns in order."""
T_ZERO = "t_zero_ns"
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


def imu(node: str) -> str:
    """Topic of a node's inertial samples."""
    return f"/{node}/imu"


def temperature(node: str) -> str:
    """Topic of a node's temperature."""
    return f"/{node}/temperature"


def battery(node: str) -> str:
    """Topic of a node's supply."""
    return f"/{node}/battery"


def bias_filter(node: str) -> str:
    """Topic of what a node's own filter says of its gyro."""
    return f"/{node}/bias_filter"


def magnetic_field(node: str) -> str:
    """Topic of a node's magnetometer."""
    return f"/{node}/mag"
