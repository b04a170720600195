"""The list of a slot's files, which lies in it: by it one knows whether an older slot is still whole."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass

from hubodo.flash.image import digests
from hubodo.flash.slots import CONFIG, MAIN
from hubodo.safe_text import json_text
from hubowire import FINGERPRINT

MANIFEST = "files.json"


@dataclass(frozen=True)
class Manifest:
    """files: SHA-256 by name in the slot, without this list. fingerprint: of the messages it speaks."""

    fingerprint: int
    files: dict[str, str]


def with_manifest(image: Mapping[str, bytes]) -> dict[str, bytes]:
    """The image with the list of what goes into its slot; last, so that it is sent when all else is there."""
    files = {name: digest for name, digest in digests(dict(image)).items() if name not in (MAIN, CONFIG)}
    text = json_text({"fingerprint": f"{FINGERPRINT:08x}", "files": files}, compact=True)
    return {**image, MANIFEST: text.encode()}


def read_manifest(text: str) -> Manifest | None:
    """What a slot says that it holds; None where that is no list."""
    try:
        table = json.loads(text)
        return Manifest(int(table["fingerprint"], 16), {str(k): str(v) for k, v in table["files"].items()})
    except (ValueError, KeyError, TypeError, AttributeError):
        return None


def stands(manifest: Manifest, slot: str, held: Mapping[str, str]) -> bool:
    """Whether a slot holds every file of its list as it was. held: path on the node to hash."""
    return bool(manifest.files) and all(
        held.get(f"{slot}/{name}") == digest for name, digest in manifest.files.items()
    )
