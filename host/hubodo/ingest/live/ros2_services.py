"""Services of a recording as a ROS 2 node: reset, set pose, find bias; each is a topic as well.

Topics reach the node over every middleware; services over DDS only those of rmw_cyclonedds (see `DdsNode`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hubodo.ingest.live.odometry_requests import FindBias, OdometryRequest, OnOutcome, SetPose
from hubodo.log import ros2
from hubodo.ros2.cdr import decode_message, encode_message
from hubodo.ros2.names import RELIABLE
from hubodo.ros2.node import Node, Reply

_ODOM_FRAMES = ("odom", "")
_PLANE = [0, 1, 5]
"""Rows of x, y and yaw in a covariance of a pose."""
_MIN_QUATERNION_NORM = 0.5

Defer = Callable[[Callable[[], None]], None]
"""Runs a function in the thread of the output."""


def _ignore(success: bool, text: str) -> None:
    """Ignore an outcome: a topic has no reply, and the event of the recording says it."""


@dataclass(frozen=True, eq=False)
class Ros2Services:
    """Services and topics `/NODE/reset`, `/NODE/set_pose` and `/NODE/find_bias`.

    put: adds a request to the recorder's queue; now_ns: host time; defer: for replies, which may block.
    """

    node: Node
    name: str
    put: Callable[[OdometryRequest], None]
    now_ns: Callable[[], int]
    defer: Defer

    def start(self) -> None:
        """Offer the services and subscribe to the topics."""
        for action, service_type, topic_type, handle in (
            ("reset", ros2.EMPTY_SERVICE, ros2.EMPTY, self._reset),
            ("set_pose", ros2.SET_POSE_SERVICE, ros2.POSE_WITH_COVARIANCE_STAMPED, self._set_pose),
            ("find_bias", ros2.TRIGGER_SERVICE, ros2.EMPTY, self._find_bias),
        ):
            self._offer(f"/{self.name}/{action}", service_type, topic_type, handle)

    def _offer(
        self,
        name: str,
        service_type: str,
        topic_type: str,
        handle: Callable[[str, Mapping[str, Any], OnOutcome], None],
    ) -> None:
        def serve(payload: bytes, reply: Reply) -> None:
            def answer(success: bool, text: str) -> None:
                values = {"success": success, "message": text}
                response = encode_message(f"{service_type}_Response", values)
                self.defer(lambda: reply(response))

            values = _decode(f"{service_type}_Request", payload)
            if values is None:
                answer(False, "the request cannot be decoded")
            else:
                handle(f"service {name}", values.get("pose", {}), answer)

        def receive(payload: bytes) -> None:
            values = _decode(topic_type, payload)
            if values is not None:
                handle(f"topic {name}", values, _ignore)

        self.node.serve(name, service_type, serve)
        self.node.subscribe(name, topic_type, RELIABLE, receive)

    def _reset(self, source: str, _: Mapping[str, Any], on_outcome: OnOutcome) -> None:
        self.put(SetPose(self.now_ns(), source, 0.0, 0.0, 0.0, np.zeros((3, 3)), on_outcome))

    def _set_pose(self, source: str, message: Mapping[str, Any], on_outcome: OnOutcome) -> None:
        frame = message["header"]["frame_id"]
        position, orientation = (message["pose"]["pose"][part] for part in ("position", "orientation"))
        x, y, z, w = (orientation[axis] for axis in "xyzw")
        refusal = ""
        if frame not in _ODOM_FRAMES:
            refusal = f"frame {frame[:40]!r}: give it in odom; map follows from GNSS"
        elif math.hypot(x, y, z, w) < _MIN_QUATERNION_NORM:
            refusal = "the orientation is not a quaternion"
        heading = math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
        covariance = np.reshape(message["pose"]["covariance"], (6, 6))[np.ix_(_PLANE, _PLANE)]
        self.put(
            SetPose(
                self.now_ns(), source, position["x"], position["y"], heading, covariance, on_outcome, refusal
            )
        )

    def _find_bias(self, source: str, _: Mapping[str, Any], on_outcome: OnOutcome) -> None:
        self.put(FindBias(self.now_ns(), source, on_outcome))


def _decode(message_type: str, payload: bytes) -> dict[str, Any] | None:
    try:
        return decode_message(message_type, payload)
    except ValueError:
        return None
