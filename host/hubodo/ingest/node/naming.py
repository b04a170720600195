"""What a node is called: as its port says, else by its id; every name once."""

from __future__ import annotations

from collections.abc import Collection

from hubowire import node_name


def free_name(wanted: str | None, node_id: int, taken: Collection[str]) -> tuple[str, bool]:
    """The name of a new node, and whether the one that it should have is another's."""
    if wanted is not None and wanted not in taken:
        return wanted, False
    name = node_name(node_id)
    if name not in taken:
        return name, False
    return next(f"{name}_{n}" for n in range(2, 300) if f"{name}_{n}" not in taken), True
