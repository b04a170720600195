"""Causes that no drive can distinguish, as both change every channel in the same way."""

from __future__ import annotations

INDISTINGUISHABLE_CAUSES: tuple[tuple[str, str, str], ...] = (
    (
        "a node turned about the axle",
        "another initial angle of its wheel",
        "both rotate ax, ay, gx and gy equally; with the sensor on the axle nothing else shows it",
    ),
    (
        "a larger radius of all wheels",
        "a reference speed that reads too much",
        "only the ratio of the two is observable; measure the radius with a tape",
    ),
    (
        "a wider track",
        "a reference yaw rate that reads too much",
        "only their product enters the difference of the wheels",
    ),
    (
        "nodes that are all stamped late",
        "a reference that is stamped early",
        "only the difference of the clocks is observable",
    ),
    (
        "a road banked to one side throughout",
        "the same accel_bias z of nodes that face the same way",
        "drive back on the same road, or turn one node round: then they differ",
    ),
    (
        "the steady part of an unbalanced wheel's hop",
        "a lever arm",
        "both grow with the square of the spin; only the part at twice per revolution is distinct",
    ),
)
"""One cause, the other cause, and why the two are indistinguishable."""
