"""Thresholds that several parts of the wheel filter share: significance, durations, accelerations, data."""

from __future__ import annotations

from hubodo.fuse.wheel.window import WINDOW_S, WINDOWS_PER_SECOND

GATE_SIGMA = 3.0
"""Sigmas beyond which a deviation is significant, one in 370 Gaussian values: an innovation loses weight, a
residual disagrees, a speed error, a rate at standstill or the error of a track width is reported."""

BUMP_WINDOWS = 3
"""Consecutive windows that no bump or pothole fills; each of them fills one. Estimated."""

SETTLING_WINDOWS = WINDOWS_PER_SECOND // 2
"""Windows in half a second: longer than a bump, a turn of a fast wheel or the interval of an encoder, shorter
than a manoeuvre. Estimated."""

MANOEUVRE_S = 2.0
"""s in which hands rock a wheel to and fro, a driver turns a steering wheel and the slope state follows a
change of slope; correlation time of the yaw rate. Estimated."""

MANOEUVRE_WINDOWS = round(MANOEUVRE_S / WINDOW_S)

DETECTION_WINDOWS = MANOEUVRE_WINDOWS + WINDOWS_PER_SECOND
"""Windows within which a standstill is detected, or gravity shows a wheel angle, after a manoeuvre."""

MAX_UNCONFIRMED_WINDOWS = 200
"""Windows (20 s) after which an inertial speed, parameters learnt before a standstill or a doubtful wheel
orientation no longer count unless they were confirmed. Estimated."""

HARD_ACCELERATION = 3.0
"""m/s² of hard braking and cornering, for seconds on end. Estimated."""

STANDSTILL_FORCE_SIGMA = 0.02
"""m/s², 1 sigma of the specific force on a stationary wheel: passengers move, the ground gives. Estimated."""

MIN_ROLLING_RATE = 1.0
"""rad/s; gravity rotates once in six seconds at it; a slower wheel is not compared with its accelerometers.
Estimated."""

MIN_ARM_LENGTH = 0.004
"""m, 1 sigma of a lever arm while gravity is searched: the arm that was assumed is removed from the force
before the search, so a wrong arm passes for a wrong spin. A shorter arm has no known direction. From 24
wheels whose drives start clipped: errors of 1 to 6 mm, where the covariance claims 0.6."""

MAX_MISSING_SHARE = 0.5
"""Share of missing samples from which on a window is not used; of clipped ones, an accelerometer axis.
Estimated."""
