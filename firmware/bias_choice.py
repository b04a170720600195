"""Create bias initialiser, estimator and warm-up according to the settings; others are not loaded."""

from time import ticks_ms

from micropython import const
from wire import (
    BIAS_KIND_GRAVITY,
    BIAS_KIND_MEAN,
    FILTER_KIND_KALMAN,
    FILTER_KIND_RLS,
)

_LIMIT_Q18 = const((1 << 29) - 1)


def estimator(s):
    """Return a new estimator (methods as of `KalmanFilter`), or None if the settings switch it off."""
    if s["filter_kind"] == FILTER_KIND_KALMAN:
        from bias_filter import KalmanFilter

        return KalmanFilter(s["gain_rate_q20"], s["gain_bias_q30"])
    if s["filter_kind"] == FILTER_KIND_RLS:
        from rls_filter import RlsFilter

        return RlsFilter(s["forgetting_q20"])
    return None


def initialisation(s, clock):
    """Return a new `BiasInitialiser`. clock: a SampleClock, for its `period_ns`."""
    kind = s["bias_kind"]
    if kind == BIAS_KIND_MEAN:
        from static_init import StaticInit

        return StaticInit()
    if kind == BIAS_KIND_GRAVITY:
        from gravity_init import GravityInit

        return GravityInit(kind, s, clock)
    from pseudo_init import PseudoInit

    return PseudoInit(kind, s, clock)


def warm_up(s, chip, was_running):
    """Return a new `WarmUp` for each exponential of the settings.

    was_running: the gyro was on before the processor started. Ticks count the time since power-on and a reset
    clears them, so a gyro that was running is assumed to be warm.
    """
    if not s["warmup_udps"]:
        return ()
    from warm_up import WarmUp

    now_ms = ticks_ms()
    age_ms = -1 if was_running else now_ms
    second = s["warmup_second"]
    first = WarmUp([steps_q18(x, chip) for x in s["warmup_udps"]], s["warmup_s"] * 1000, now_ms, age_ms)
    if not second or second[3] < 10:
        return (first,)
    return first, WarmUp([steps_q18(x, chip) for x in second[:3]], second[3] * 1000, now_ms, age_ms)


def known_bias_q18(s, axis, chip):
    """Return the bias of the settings, without warm-up; None where they have none."""
    return steps_q18(s["bias_udps"][axis], chip) if s["bias_udps"] else None


def steps_q18(udps, chip):
    """Convert 1e-6 deg/s to 2^-18 gyro steps, clipped to +-2^29; allocates large integers."""
    if not udps:
        return 0
    steps = (udps * 524288000 // chip.gyro_lsb_ndps + 1) >> 1
    return max(min(steps, _LIMIT_Q18), -_LIMIT_Q18)
