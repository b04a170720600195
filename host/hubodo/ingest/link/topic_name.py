"""Port arguments that are ROS 2 topics: `[NAME=]ros2:/TOPIC`."""

from __future__ import annotations

import re

TOPIC_KIND = "ros2"
"""Kind of a port that is a topic."""
_TOPIC_PORT = re.compile(rf"([A-Za-z][\w-]*=)?{TOPIC_KIND}:.*")
_TOPIC_NAME = re.compile(r"(/[A-Za-z_]\w*)+(:[^:]*)?", re.ASCII)


def is_topic(text: str) -> bool:
    """Return True if a port argument is a topic, valid or not."""
    return _TOPIC_PORT.fullmatch(text) is not None


def is_valid_topic(topic: str) -> bool:
    """Return True for a name that ROS 2 allows, from the root, which the names of joints may follow."""
    return _TOPIC_NAME.fullmatch(topic) is not None
