"""Unique names of nodes and links: from the port argument, else from the node id."""

from __future__ import annotations

from collections.abc import Collection
from itertools import count

from hubowire import node_name


def unique_name(wanted: str, used_names: Collection[str]) -> str:
    """Return the wanted name, or the first of wanted_2, wanted_3, ... that is not in use."""
    if wanted not in used_names:
        return wanted
    return next(name for n in count(2) if (name := f"{wanted}_{n}") not in used_names)


def assign_name(wanted: str | None, node_id: int, used_names: Collection[str]) -> tuple[str, bool]:
    """Return a unique name for a new node, and True if its standard name was already in use."""
    if wanted is not None and wanted not in used_names:
        return wanted, False
    name = node_name(node_id)
    return unique_name(name, used_names), name in used_names
