"""The manifest of a slot: the hashes of its files, to check later whether it is still complete."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass

from hubodo.flash.image import hash_files
from hubodo.flash.slots import CONFIG, MAIN
from hubodo.safe_text import json_text
from hubowire import FINGERPRINT

MANIFEST = "files.json"


@dataclass(frozen=True)
class Manifest:
    """The hashes of a slot's files by name, and the fingerprint of its protocol."""

    fingerprint: int
    files: dict[str, str]


def add_manifest(image: Mapping[str, bytes]) -> dict[str, bytes]:
    """Return the image with its manifest as the last file, which is sent when all others are complete."""
    files = {name: digest for name, digest in hash_files(dict(image)).items() if name not in (MAIN, CONFIG)}
    text = json_text({"fingerprint": f"{FINGERPRINT:08x}", "files": files}, compact=True)
    return {**image, MANIFEST: text.encode()}


def read_manifest(text: str) -> Manifest | None:
    """Return a manifest, or None if the text is none."""
    try:
        table = json.loads(text)
        return Manifest(int(table["fingerprint"], 16), {str(k): str(v) for k, v in table["files"].items()})
    except (ValueError, KeyError, TypeError, AttributeError):
        return None


def is_complete(manifest: Manifest, slot: str, held: Mapping[str, str]) -> bool:
    """Return True if a slot holds every file of its manifest unchanged; `held` are hashes by path."""
    return bool(manifest.files) and all(
        held.get(f"{slot}/{name}") == digest for name, digest in manifest.files.items()
    )
