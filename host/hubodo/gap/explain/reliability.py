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
        "98 of 108 named on their node; from sensors on the rims, on which nothing was tuned, 47 of 54",
        "a lag of 10 ms, a scale of accelerometers of 2 %; a clock skew is given to the wrong node",
    ),
)
"""Logs, measured result, and what is not good yet."""
