"""Events about a node: power-on, final health report, final clock estimate."""

from __future__ import annotations

from hubodo.ingest.node.clock import TICK_PERIOD_US, ClockEstimate
from hubodo.ingest.node.health import health_json
from hubodo.recording import Event
from hubodo.units import NS_PER_S
from hubowire.messages import Health


def power_on_event(node: str, boot_id: int, power_on_ns: int, t_ns: int) -> Event:
    """Return the event of a node's first sample after a boot, at `t_ns`, with its time since power-on."""
    age = (t_ns - power_on_ns) / NS_PER_S
    data = {
        "node": node,
        "boot_id": boot_id,
        "power_on_ns": power_on_ns,
        "age": age,
        "age_modulo": TICK_PERIOD_US * 1e-6,
    }
    text = f"{node}: powered on {age:.1f} s before this sample, or a multiple of 18 min earlier"
    return Event(t_ns, "started", node, text, data)


def lag_event(node: str, lag_ns: int, duration_ns: int, t_ns: int) -> Event:
    """Return the event of samples dated too late until t_ns, by `lag_ns`; duration_ns: of the correction."""
    lag, duration = lag_ns / NS_PER_S, duration_ns / NS_PER_S
    text = (
        f"{node}: its samples so far were read {lag:.3g} s late and are dated that much too late; times are "
        f"corrected by 0.1 % of the time, for {duration / 60.0:.0f} min. Its own distances stay valid; for "
        "times that agree with other sensors at once, start the recording again"
    )
    return Event(t_ns, "lag", node, text, {"node": node, "lag": lag, "duration_s": duration})


def final_health_event(node: str, health: Health, now_ns: int) -> Event:
    """Return the event of a node's counters at the end of the recording."""
    return Event(now_ns, "health", node, f"{node}: last report of the node", health_json(node, health))


def final_clock_event(node: str, estimate: ClockEstimate, now_ns: int) -> Event:
    """Return the event of a node's clock estimate at the end of the recording."""
    text = (
        f"{node}: clock {estimate.source}, drift {estimate.drift * 1e6:+.1f} ppm, "
        f"1 sigma {estimate.sigma_ns * 1e-6:.3f} ms"
    )
    return Event(now_ns, "clock", node, text, {"node": node, **estimate.as_json()})
