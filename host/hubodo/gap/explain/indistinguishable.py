"""What no drive can tell apart, however long: two causes that move every channel alike."""

from __future__ import annotations

INDISTINGUISHABLE_CAUSES: tuple[tuple[str, str, str], ...] = (
    (
        "a node turned about the axle",
        "the angle at which its wheel stood at first",
        "both turn ax, ay, gx and gy alike; with the sensor on the axle nothing else shows it",
    ),
    (
        "a larger radius of all wheels",
        "a reference speed that reads too much",
        "only the ratio of the two is seen; a tape measure tells them apart",
    ),
    (
        "a wider track",
        "a reference yaw rate that reads too much",
        "in the difference of the wheels only their product is seen",
    ),
    (
        "nodes that are all stamped late",
        "a reference that is stamped early",
        "nothing tells which clock is right",
    ),
    (
        "a road banked to one side all the way",
        "the same accel_bias z of nodes that face one way",
        "drive it back, or turn a node round: then they differ",
    ),
    (
        "the steady part of an unbalanced wheel's hop",
        "a lever arm",
        "both grow with the square of the spin; twice per revolution the hop shows by itself",
    ),
)
"""One, the other, and why."""
