"""Two folders of the node that take the firmware in turn, and main.py, which names the one that runs.

New firmware goes into the folder that does not run. While it is written, and when power fails or the host
goes away meanwhile, the node starts what it had; when every hash is right, main.py is replaced by a rename,
which is one step for the node's file system. The folder that ran stays: files that did not change are copied
from it on the node, and the node falls back to it where the new firmware does not load.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from hubodo.flash.image import ImageError

SLOTS = ("/fw_a", "/fw_b")
MAIN, CONFIG = "main.py", "config.json"
NEW = ".new"
"""Behind the name of a file at the root that waits to take its place."""

_AS_SOURCE = 'SLOTS = ("",)'
_NAMED = re.compile(r'^SLOTS = \("(/\w+)"', re.MULTILINE)


def main_for(source: bytes, slot: str) -> bytes:
    """main.py that starts the firmware of `slot`, or else of the other.

    Raises ImageError when the source has no line for it.
    """
    text = source.decode()
    if text.count(_AS_SOURCE) != 1:
        raise ImageError(
            f"{MAIN}: the line {_AS_SOURCE} is not there once; take the firmware of this version"
        )
    return text.replace(_AS_SOURCE, slots_line(slot)).encode()


def slots_line(slot: str) -> str:
    """The line of main.py that starts the firmware of `slot`, or else of the other."""
    return f'SLOTS = ("{slot}", "{other(slot)}")'


def other(slot: str | None) -> str:
    """The slot that is free while `slot` runs."""
    return SLOTS[1] if slot == SLOTS[0] else SLOTS[0]


def slot_named(main: str) -> str | None:
    """The slot that a node's main.py names first; None for one that runs the files beside it."""
    named = _NAMED.search(main)
    return named[1] if named is not None and named[1] in SLOTS else None


@dataclass(frozen=True)
class Plan:
    """What puts an image onto a node.

    slot: where the firmware goes, None when the node runs it already. remove: paths in the way there. copy:
    (from, to) on the node. send: path on the node to contents. swap: names at the root that get a new file.
    expect: path to hash before the swap. forget: paths left by a node that had its firmware at the root.
    """

    slot: str | None
    remove: tuple[str, ...]
    copy: tuple[tuple[str, str], ...]
    send: dict[str, bytes]
    swap: tuple[str, ...]
    expect: dict[str, str]
    forget: tuple[str, ...]


def plan(
    image: Mapping[str, bytes], hashes: Mapping[str, str], held: Mapping[str, str], running: str | None
) -> Plan:
    """The plan for a node.

    image: name to contents, with MAIN, perhaps CONFIG. hashes: by name, of main.py for each slot under the
    slot's name. held: path on the node to hash. running: what its main.py names.
    """
    firmware = {name: hashes[name] for name in image if name not in (MAIN, CONFIG)}
    swap = [CONFIG] if CONFIG in image and held.get("/" + CONFIG) != hashes[CONFIG] else []
    send, expect = {f"/{name}{NEW}": image[name] for name in swap}, {}
    slot, remove, copy = None, [], []
    if running is None or not _stands(running, firmware, held) or held.get("/" + MAIN) != hashes[running]:
        slot = other(running)
        there = {path: digest for path, digest in held.items() if path.startswith(slot + "/")}
        wanted = {f"{slot}/{name}": digest for name, digest in firmware.items()}
        remove = [path for path in there if path not in wanted]
        where = {digest: path for path, digest in held.items() if not path.startswith(slot + "/")}
        for name, digest in firmware.items():
            path = f"{slot}/{name}"
            if there.get(path) == digest:
                continue
            if digest in where:
                copy.append((where[digest], path))
            else:
                send[path] = image[name]
        send[f"/{MAIN}{NEW}"] = main_for(image[MAIN], slot)
        expect = wanted | {f"/{MAIN}{NEW}": hashes[slot]}
        swap.append(MAIN)
    expect |= {f"/{CONFIG}{NEW}": hashes[CONFIG]} if CONFIG in swap else {}
    at_root = {f"/{name.removesuffix('.mpy').removesuffix('.py')}" for name in firmware}
    forget = [path for path in held if re.sub(r"\.m?py$", "", path) in at_root]
    return Plan(slot, tuple(remove), tuple(copy), send, tuple(swap), expect, tuple(forget))


def _stands(slot: str, firmware: Mapping[str, str], held: Mapping[str, str]) -> bool:
    """Whether a slot holds the firmware and nothing else."""
    there = {path: digest for path, digest in held.items() if path.startswith(slot + "/")}
    return there == {f"{slot}/{name}": digest for name, digest in firmware.items()}
