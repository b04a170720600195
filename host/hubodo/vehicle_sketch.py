"""The text of a vehicle file, and a text sketch of the vehicle from above."""

from __future__ import annotations

from hubodo.lengths import format_length
from hubodo.toml_file import toml_key, toml_number, toml_text
from hubodo.vehicle import Vehicle, has_unusual_size

_WIDTH = 15  # characters between the wheels


def vehicle_toml(vehicle: Vehicle) -> str:
    """Return the text of a vehicle file."""
    lines = ["[vehicle]"]
    if vehicle.name:
        lines.append(f"name = {toml_text(vehicle.name)}")
    lines += [
        f"wheel_radius = {toml_number(vehicle.wheel_radius)}     # m",
        f"track_width = {toml_number(vehicle.track_width)}       # m, between the contact points",
    ]
    if vehicle.radius_from != "nominal":
        lines.append(f'radius_from = "{vehicle.radius_from}"')
    if has_unusual_size(vehicle):
        lines.append("unusual_size = true")
    if vehicle.antenna is not None:
        forward, left = vehicle.antenna
        lines.append(
            f"antenna = [{toml_number(forward)}, {toml_number(left)}]   # m forward, left of the axle"
        )
    if vehicle.latitude_deg is not None:
        lines.append(f"latitude_deg = {toml_number(vehicle.latitude_deg)}")
    for name, mount in vehicle.nodes.items():
        lines += ["", f"[nodes.{toml_key(name)}]"]
        if mount.side is not None:
            lines += [
                f'side = "{mount.side}"      # which wheel',
                f'facing = "{mount.facing}"    # where its z axis points',
            ]
    return "\n".join(lines) + "\n"


def draw_vehicle(vehicle: Vehicle) -> list[str]:
    """Return the lines of a sketch from above: wheels, nodes, the directions of their z axes, sizes."""
    left, right, radius = vehicle.node_on_wheel("left"), vehicle.node_on_wheel("right"), vehicle.wheel_radius
    middle = format_length(vehicle.track_width).center(_WIDTH, "─")
    edges = f"      ┌───┐{' ' * _WIDTH}┌───┐"
    lines = [
        f"{'▲ forward':>{20 + len('forward')}}",
        edges,
        f"{_outside(vehicle, left, 'left')}│{_letter(left, 'L')}├{middle}┤{_letter(right, 'R')}│"
        f"{_outside(vehicle, right, 'right')}",
        edges.replace("┌", "└").replace("┐", "┘"),
        f"wheel: radius {format_length(radius)}, diameter {format_length(2.0 * radius)}",
    ]
    for name, mount in vehicle.nodes.items():
        if mount.side is None:
            lines.append(f"node {name}: on the body")
        else:
            direction = "outwards" if mount.side == mount.facing else "towards the vehicle"
            lines.append(
                f"node {name}: on the {mount.side} wheel, z axis points {mount.facing} ({direction})"
            )
    return lines


def _letter(node: str | None, letter: str) -> str:
    """Return the text inside the outline of a wheel; a wheel without a node is empty."""
    return "   " if node is None else f" {letter} "


def _outside(vehicle: Vehicle, node: str | None, side: str) -> str:
    """Return the z axis of the node on a wheel, drawn beside the wheel."""
    if node is None:
        return "      " if side == "left" else ""
    arrow = "← z" if vehicle.nodes[node].facing == "left" else "z →"
    return f"{arrow:>5} " if side == "left" else f" {arrow}"
