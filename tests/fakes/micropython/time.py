"""Ticks that advance only by `run` and by sleeping, as `time` on a fake port; nothing here allocates."""

from micropython import const

_MASK = const(0x3FFFFFFF)
_HALF = const(0x20000000)
_now = [0]


def run(us):
    _now[0] = (_now[0] + us) & _MASK


def run_until(ticks):
    """Advance the time to just before `ticks`, unless that has passed."""
    ahead = ticks_diff(ticks, _now[0]) - 20
    if ahead > 0:
        run(ahead)


def ticks_us():
    _now[0] = (_now[0] + 5) & _MASK
    return _now[0]


def ticks_ms():
    return _now[0] // 1000


def ticks_add(ticks, delta):
    return (ticks + delta) & _MASK


def ticks_diff(end, begin):
    ticks = (end - begin) & _MASK
    return ticks - _MASK - 1 if ticks >= _HALF else ticks


def sleep_us(us):
    run(us)


def sleep_ms(ms):
    run(1000 * ms)
