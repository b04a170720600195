"""Two folders of the node that hold the firmware in turn, and main.py, which selects the one that runs.

New firmware is written into the inactive folder. Meanwhile, and if power or connection fails, the node starts
its old firmware; when every hash is verified, main.py is replaced by a rename, an atomic operation of the
node's file system. The previous folder remains: unchanged files are copied from it on the node, and the node
falls back to it if the new firmware does not load.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from hubodo.flash.image import ImageError

SLOTS = ("/fw_a", "/fw_b")
MAIN, CONFIG = "main.py", "config.json"
NEW_SUFFIX = ".new"
"""Suffix of a file at the root that is about to replace another."""

_SOURCE_SLOTS_LINE = 'SLOTS = ("",)'
_FIRST_SLOT = re.compile(r'^SLOTS = \("(/\w+)"', re.MULTILINE)


def main_for_slot(source: bytes, slot: str) -> bytes:
    """Return main.py for a slot, with the other slot as fallback.

    Raises ImageError if the source lacks the line to replace.
    """
    text = source.decode()
    if text.count(_SOURCE_SLOTS_LINE) != 1:
        raise ImageError(
            f"{MAIN}: the line {_SOURCE_SLOTS_LINE} must occur once; use the firmware of this version"
        )
    return text.replace(_SOURCE_SLOTS_LINE, slots_line(slot)).encode()


def slots_line(slot: str) -> str:
    """Return the line of main.py that selects `slot`, with the other slot as fallback."""
    return f'SLOTS = ("{slot}", "{other_slot(slot)}")'


def other_slot(slot: str | None) -> str:
    """Return the inactive slot while `slot` runs."""
    return SLOTS[1] if slot == SLOTS[0] else SLOTS[0]


def active_slot(main: str) -> str | None:
    """Return the first slot in a node's main.py, or None if it runs files at the root."""
    match = _FIRST_SLOT.search(main)
    return match[1] if match is not None and match[1] in SLOTS else None


@dataclass(frozen=True)
class FlashPlan:
    """The steps that put an image onto a node.

    Attributes
    ----------
    slot
        Destination of the firmware; None if the node has it already.
    remove
        Obsolete paths in the slot.
    copy
        (source, destination) of copies on the node.
    send
        Content by path.
    swap
        Names at the root that are replaced.
    expected_hashes
        Hash by path, to verify before the swap.
    obsolete
        Paths of an older installation at the root, to delete.
    """

    slot: str | None
    remove: tuple[str, ...]
    copy: tuple[tuple[str, str], ...]
    send: dict[str, bytes]
    swap: tuple[str, ...]
    expected_hashes: dict[str, str]
    obsolete: tuple[str, ...]


def plan_flash(
    image: Mapping[str, bytes], hashes: Mapping[str, str], held: Mapping[str, str], running: str | None
) -> FlashPlan:
    """Return the plan for a node.

    image: content by name, with MAIN and optionally CONFIG. hashes: by name; those of main.py under the name
    of each slot. held: hash by path on the node. running: the slot selected by its main.py.
    """
    firmware = {name: hashes[name] for name in image if name not in (MAIN, CONFIG)}
    swap = [CONFIG] if CONFIG in image and held.get("/" + CONFIG) != hashes[CONFIG] else []
    send, expect = {f"/{name}{NEW_SUFFIX}": image[name] for name in swap}, {}
    slot, remove, copy = None, [], []
    if (
        running is None
        or not _holds_exactly(running, firmware, held)
        or held.get("/" + MAIN) != hashes[running]
    ):
        slot = other_slot(running)
        present = {path: digest for path, digest in held.items() if path.startswith(slot + "/")}
        required = {f"{slot}/{name}": digest for name, digest in firmware.items()}
        remove = [path for path in present if path not in required]
        available = {digest: path for path, digest in held.items() if not path.startswith(slot + "/")}
        for name, digest in firmware.items():
            path = f"{slot}/{name}"
            if present.get(path) == digest:
                continue
            if digest in available:
                copy.append((available[digest], path))
            else:
                send[path] = image[name]
        send[f"/{MAIN}{NEW_SUFFIX}"] = main_for_slot(image[MAIN], slot)
        expect = required | {f"/{MAIN}{NEW_SUFFIX}": hashes[slot]}
        swap.append(MAIN)
    expect |= {f"/{CONFIG}{NEW_SUFFIX}": hashes[CONFIG]} if CONFIG in swap else {}
    at_root = {f"/{name.removesuffix('.mpy').removesuffix('.py')}" for name in firmware}
    forget = [path for path in held if re.sub(r"\.m?py$", "", path) in at_root]
    return FlashPlan(slot, tuple(remove), tuple(copy), send, tuple(swap), expect, tuple(forget))


def _holds_exactly(slot: str, firmware: Mapping[str, str], held: Mapping[str, str]) -> bool:
    """Return True if a slot holds the firmware and nothing else."""
    present = {path: digest for path, digest in held.items() if path.startswith(slot + "/")}
    return present == {f"{slot}/{name}": digest for name, digest in firmware.items()}
