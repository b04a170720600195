"""Rosbag2 folders compressed by the recorder, by file or by message: expanded within a limit."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable
from pathlib import Path

import zstandard

from hubodo.errors import InputError
from hubodo.log.input_limits import (
    MemoryBudget,
    check_claim,
    check_regular,
    file_budget,
    limit_bytes,
    open_regular,
    room_of,
)

Expander = Callable[[bytes], bytes]
_LARGEST_METADATA = 16 << 20  # bytes
_PORTION = 1 << 20  # bytes
_SUFFIX = ".zstd"


def compression_mode(metadata: Path) -> str:
    """Return "file", "message" or "" as the metadata.yaml of a bag says.

    Nothing else of that file is needed, so it is not parsed: aliases in YAML can expand without limit.
    """
    try:
        with open_regular(metadata) as stream:
            text = stream.read(_LARGEST_METADATA).decode("utf-8", "replace")
    except OSError:
        return ""
    found = re.search(r"compression_mode: *['\"]?(file|message)", text, re.IGNORECASE)
    return found[1].lower() if found else ""


class StorageFiles:
    """The files of a rosbag2 folder that hold messages; compressed ones are expanded into a temporary folder.

    Raises InputError where that exceeds the memory limit or what such a file can hold.
    """

    def __init__(self, folder: Path) -> None:
        self._temporary: tempfile.TemporaryDirectory[str] | None = None
        self.databases = self._of_kind(folder, ".db3")
        self.logs = [] if self.databases else self._of_kind(folder, ".mcap")

    def close(self) -> None:
        """Remove what was expanded. Idempotent."""
        if self._temporary is not None:
            self._temporary.cleanup()
            self._temporary = None

    def _of_kind(self, folder: Path, suffix: str) -> list[Path]:
        plain, packed = sorted(folder.glob(f"*{suffix}")), sorted(folder.glob(f"*{suffix}{_SUFFIX}"))
        for path in (*plain, *packed):
            check_regular(path)
        return plain or [self._expanded(path) for path in packed]

    def _expanded(self, packed: Path) -> Path:
        if self._temporary is None:
            self._temporary = tempfile.TemporaryDirectory(prefix="hubodo-")
        plain = Path(self._temporary.name) / packed.name.removesuffix(_SUFFIX)
        budgets = (file_budget(packed, room_of(packed.stat().st_size)), MemoryBudget(packed))
        try:
            with open_regular(packed) as source, plain.open("wb") as target:
                reader = zstandard.ZstdDecompressor().stream_reader(source, read_across_frames=True)
                while part := reader.read(_PORTION):
                    for budget in budgets:
                        budget.claim(len(part), "what it expands to")
                    target.write(part)
        except zstandard.ZstdError as error:
            raise InputError(f"{packed}: does not decompress ({error}); copy it again") from None
        return plain


def message_expander(folder: Path) -> Expander:
    """Return a function that expands one message of a bag. Raises ValueError for what does not decompress."""
    size = sum(path.stat().st_size for path in folder.iterdir() if path.is_file())
    room = file_budget(folder, room_of(size))

    def expand(data: bytes) -> bytes:
        limit = min(limit_bytes(), room.limit - room.claimed)
        try:
            claimed = zstandard.frame_content_size(data)
            if claimed > limit:
                check_claim(claimed, folder, "a message")
                room.claim(claimed, "the sum of its messages")
            expanded = zstandard.ZstdDecompressor().decompress(data, max_output_size=max(1, limit))
        except zstandard.ZstdError as error:
            raise ValueError(f"a message does not decompress: {error}") from None
        room.claim(len(expanded), "the sum of its messages")
        return expanded

    return expand
