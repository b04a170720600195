"""Names of nodes and links: as the port says, else by the node id; no name twice."""

from __future__ import annotations

from collections.abc import Collection
from itertools import count

from hubowire import node_name


def unique_name(wanted: str, taken: Collection[str]) -> str:
    """Return the wanted name, or the first of wanted_2, wanted_3, ... that is not taken."""
    if wanted not in taken:
        return wanted
    return next(name for n in count(2) if (name := f"{wanted}_{n}") not in taken)


def free_name(wanted: str | None, node_id: int, taken: Collection[str]) -> tuple[str, bool]:
    """Return the name of a new node, and whether the one it should have belongs to another."""
    if wanted is not None and wanted not in taken:
        return wanted, False
    name = node_name(node_id)
    return unique_name(name, taken), name in taken
