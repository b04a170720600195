"""The kind of node that the settings ask for; loaded while it is created, as its names cost heap."""

import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any


def create(board, link):
    """Return a receiver, or a node with the second accelerometer and the lower rate of its settings."""
    settings = board.settings
    if settings.get("receiver"):
        from radio import receiver

        return receiver.Receiver(board, link)
    if settings.get("high_g_rate_hz"):
        from high_g import HighGNode

        node: Any = HighGNode(board, link)
    else:
        from node import Node

        node = Node(board, link)
    can_sleep = settings["link"] not in ("udp", "ble", "espnow") and sys.platform in ("rp2", "esp32")
    if settings.get("park_after_s") and can_sleep:
        import parking

        node.slow = parking.Parking(node)
    elif settings.get("rest_after_s"):
        import slow_sampling

        node.slow = slow_sampling.SlowSampling(node)
    return node
