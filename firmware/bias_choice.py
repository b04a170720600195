"""Which initialisation, estimator and warm-up the settings ask for; what is not chosen is not loaded."""

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
    """A new estimator as the settings say, or None: begin, drift, update, rate_q8, bias_q12, saturations."""
    if s["filter_kind"] == FILTER_KIND_KALMAN:
        from bias_filter import KalmanFilter

        return KalmanFilter(s["gain_rate_q20"], s["gain_bias_q30"])
    if s["filter_kind"] == FILTER_KIND_RLS:
        from rls_filter import RlsFilter

        return RlsFilter(s["forgetting_q20"])
    return None


def initialisation(s, clock):
    """A new `BiasInitialiser` as the settings say. clock: has `period_ns`."""
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
    """A new `WarmUp` for each exponential of the settings. was_running: the gyro ran before the processor.

    Its age is that of the ticks, which a reset starts anew: a gyro that ran through one is taken to be warm.
    """
    if not s["warmup_udps"]:
        return ()
    from warm_up import WarmUp

    now_ms = ticks_ms()
    age_ms = -1 if was_running else now_ms
    second = s["warmup_second"]
    made = WarmUp([steps_q18(x, chip) for x in s["warmup_udps"]], s["warmup_s"] * 1000, now_ms, age_ms)
    if not second or second[3] < 10:
        return (made,)
    return made, WarmUp([steps_q18(x, chip) for x in second[:3]], second[3] * 1000, now_ms, age_ms)


def known_bias_q18(s, axis, chip):
    """The bias that the settings know, without warm-up; None when they do not."""
    return steps_q18(s["bias_udps"][axis], chip) if s["bias_udps"] else None


def steps_q18(udps, chip):
    """1e-6 deg/s in 2^-18 gyro steps, held within +-2^29; by large integers, before anything samples."""
    if not udps:
        return 0
    steps = (udps * 524288000 // chip.gyro_lsb_ndps + 1) >> 1
    return max(min(steps, _LIMIT_Q18), -_LIMIT_Q18)
