"""Unique names of nodes and links: from the port argument, else from the node id."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from itertools import count

from hubodo.log.topics import NODE_RECORD_PREFIX
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


class RecordedNames:
    """The node names of a log that is decoded again: a board keeps the name that it has in the log.

    Without this, two boards with one node id could exchange their names, because a name depends on whose
    frame arrives first.
    """

    def __init__(self, metadata_records: Mapping[str, Mapping[str, str]]) -> None:
        self._by_serial: dict[str, list[str]] = {}
        self._used_names: set[str] = set()
        for record, values in metadata_records.items():
            if record.startswith(NODE_RECORD_PREFIX) and (serial := values.get("serial")):
                name = record.removeprefix(NODE_RECORD_PREFIX)
                self._by_serial.setdefault(serial, []).append(name)

    def assign(self, wanted: str | None, node_id: int, serial: bytes) -> str:
        """Return a unique name for a node; wanted: that of its port, if any; serial: empty if unknown."""
        own, reserved = [], set[str]()
        for owner, names in self._by_serial.items() if serial else ():
            if owner == serial.hex():
                own = names
            else:
                reserved.update(names)
        candidates = [wanted] if wanted is not None and wanted not in reserved else []
        name = next((name for name in candidates + own if name not in self._used_names), None)
        if name is None:
            name, _ = assign_name(wanted, node_id, self._used_names | reserved)
        self._used_names.add(name)
        return name
