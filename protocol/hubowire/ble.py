"""The GATT service of a node, and the flow control of its notifications; see protocol/README.md."""

from __future__ import annotations

SERVICE_UUID = "670ba625-1817-4787-999a-e477d2888606"
FRAMES_UUID = "670ba625-1817-4787-999a-e477d2888607"
"""Characteristic by which the node notifies frames."""
REQUESTS_UUID = "670ba625-1817-4787-999a-e477d2888608"
"""Characteristic to which the host writes requests."""
REPORTS_UUID = "670ba625-1817-4787-999a-e477d2888609"
"""Characteristic to which the host writes how many notifications it has received."""

WINDOW = 12
"""Notifications that a node sends beyond those that the host has reported as received."""
REPORT_INTERVAL = 4
"""Number of notifications after which a host reports."""
NAME_PREFIX = "hubodo-"


def encode_report(count: int) -> bytes:
    """Return the report of `count` notifications received on a connection."""
    return (count & 0xFFFF).to_bytes(2, "little")
