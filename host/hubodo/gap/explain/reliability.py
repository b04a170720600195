"""Measured reliability of names on simulated and on real logs, for the page."""

RELIABILITY: tuple[tuple[str, str, str], ...] = (
    (
        "another simulator (make gap-matrix): each of 28 effects in two drives, strong, medium, weak",
        "ranked first in 56, 55 and 28 of 56; 0 false detections in 40 drives without an effect",
        "weak effects: half of them",
    ),
    (
        "the same, three to five effects at once (make gap-several)",
        "110 of 112 detected; 0.07 false detections per set",
        "",
    ),
    (
        "real drives of a car, effects put into their samples, model of another drive (make gap-real)",
        "named less often than in simulated logs; the figures are printed by the command",
        "time offsets, g-sensitivity and scales of accelerometers are often missed; "
        "a lag brings further names",
    ),
)
"""Logs, measured result, and what is not good yet."""
