"""The nodes of a recording that sit on wheels: their selection, their ranges, and warnings about them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

from hubodo.errors import InputError
from hubodo.fuse.range_extension import extend_table
from hubodo.fuse.ranges import NodeRanges, determine_ranges, node_metadata, uncorrected_accel_limit
from hubodo.recording import Recording, missing_channels
from hubodo.vehicle import Vehicle


def select_wheel_nodes(
    recording: Recording, vehicle: Vehicle, wanted: Sequence[str] | None, log: str
) -> tuple[str, ...]:
    """Return the names of the nodes that sit on wheels and are in the log, restricted to `wanted` if given.

    Raises InputError when a wanted node is missing, or no node is left.
    """
    on_wheels = [name for name, mount in vehicle.nodes.items() if mount.side is not None]
    in_log = ", ".join(recording.nodes) or "none"
    for name in wanted or ():
        if name not in on_wheels:
            known = ", ".join(on_wheels) or "none"
            raise InputError(f"node {name!r}: not on a wheel in the vehicle file (those are: {known})")
        if name not in recording.nodes:
            raise InputError(f"{log}: no node {name!r} in the log (there: {in_log})")
    selected = tuple(name for name in on_wheels if name in recording.nodes and (not wanted or name in wanted))
    if not selected:
        raise InputError(
            f"{log}: none of the vehicle's wheel nodes ({', '.join(on_wheels) or 'none'}) is in the log "
            f"(there: {in_log}); name the nodes in the vehicle file as in the log, say which topic is which "
            "with --topic, or rename a number file to the name of its node, such as left.csv"
            + "".join(f"; {line}" for line in recording.warnings if "not used: " in line)
        )
    for name in selected:
        if missing := missing_channels(recording.nodes[name]):
            raise InputError(
                f"{log}: node {name} has no {', '.join(missing)}; the wheel filter needs all six channels"
            )
    return selected


def determine_log_ranges(
    recording: Recording, vehicle: Vehicle, names: Sequence[str], *, corrected: bool = False
) -> dict[str, NodeRanges]:
    """Return the ranges of all nodes of a recording; corrected: whether their samples will be calibrated."""
    metadata = recording.metadata
    return {
        name: determine_ranges(
            vehicle.nodes[name], node_metadata(metadata, name), recording.nodes[name], corrected=corrected
        )
        for name in names
    }


def extend_ranges(recording: Recording, ranges: Mapping[str, NodeRanges]) -> Recording:
    """Return the recording with saturated accelerations replaced where a node has a second accelerometer."""
    extended = {
        name: extend_table(
            recording.nodes[name], recording.high_g[name], uncorrected_accel_limit(ranges[name].accel.value)
        )
        for name in ranges
        if name in recording.high_g
    }
    return replace(recording, nodes={**recording.nodes, **extended}) if extended else recording


def steering_warnings(vehicle: Vehicle, names: Sequence[str], used: Collection[str]) -> tuple[str, ...]:
    """Return warnings about wheels that steer."""
    used_names = " and ".join(used)
    left_out = [
        f"{name}: steered; the track comes from {used_names} alone" for name in names if name not in used
    ]
    own_contact = [
        f"{name}: steered; the track is that of this wheel's contact point, with the wheel's own heading"
        for name in used
        if vehicle.nodes[name].steered
    ]
    return (*left_out, *own_contact)


def missing_node_warnings(
    recording: Recording, vehicle: Vehicle, names: Sequence[str], wanted: Sequence[str] | None
) -> tuple[str, ...]:
    """Return warnings about nodes of the vehicle that are not used."""
    on_wheels = wanted or [name for name, mount in vehicle.nodes.items() if mount.side is not None]
    reasons = {
        name: "not in the log" if name not in recording.nodes else "no usable samples"
        for name in on_wheels
        if name not in names and not vehicle.nodes[name].steered
    }
    used_names = " and ".join([*names, "wheels.csv"] if recording.wheels is not None else names)
    return tuple(f"{name}: {text}; the track comes from {used_names} alone" for name, text in reasons.items())
