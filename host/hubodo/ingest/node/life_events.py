"""What a log keeps of a node besides its samples: when it was switched on, its last report, its clock."""

from __future__ import annotations

from hubodo.ingest.node.clock import PERIOD_US, ClockEstimate
from hubodo.ingest.node.health import health_data
from hubodo.recording import Event
from hubodo.units import NS_PER_S
from hubowire.messages import Health


def switched_on(node: str, boot_id: int, power_on_ns: int, t_ns: int) -> Event:
    """A node's first sample after a start, at t_ns, with the time since power-on as its ticks tell it."""
    age = (t_ns - power_on_ns) / NS_PER_S
    data = {
        "node": node,
        "boot_id": boot_id,
        "power_on_ns": power_on_ns,
        "age": age,
        "age_modulo": PERIOD_US * 1e-6,
    }
    text = f"{node}: switched on {age:.1f} s before this sample, or a multiple of 18 min earlier"
    return Event(t_ns, "started", node, text, data)


def last_report(node: str, health: Health, now_ns: int) -> Event:
    """A node's counters at the end of the recording."""
    return Event(now_ns, "health", node, f"{node}: last report of the node", health_data(node, health))


def clock_found(node: str, estimate: ClockEstimate, now_ns: int) -> Event:
    """What is known of a node's clock at the end of the recording."""
    text = (
        f"{node}: clock {estimate.source}, drift {estimate.drift * 1e6:+.1f} ppm, "
        f"1 sigma {estimate.sigma_ns * 1e-6:.3f} ms"
    )
    return Event(now_ns, "clock", node, text, {"node": node, **estimate.as_json()})
