"""Expand rosbag2 folders that the recorder compressed by file or by message, within a size limit."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable
from pathlib import Path

import zstandard

from hubodo.errors import InputError
from hubodo.log.input_limits import (
    READ_BLOCK_BYTES,
    MemoryBudget,
    check_claim,
    check_regular,
    file_budget,
    limit_bytes,
    max_expanded_bytes,
    open_regular,
)

Expander = Callable[[bytes], bytes]
_MAX_METADATA_BYTES = 16 << 20  # bytes
_SUFFIX = ".zstd"


def read_compression_mode(metadata: Path) -> str:
    """Return the compression mode in the metadata.yaml of a bag: "file", "message" or "".

    The file is searched, not parsed as YAML, whose aliases can expand without limit.
    """
    try:
        with open_regular(metadata) as stream:
            text = stream.read(_MAX_METADATA_BYTES).decode("utf-8", "replace")
    except OSError:
        return ""
    match = re.search(r"compression_mode: *['\"]?(file|message)", text, re.IGNORECASE)
    return match[1].lower() if match else ""


class StorageFiles:
    """The message files of a rosbag2 folder; compressed ones are expanded into a temporary folder.

    Raises InputError if the expanded size exceeds the memory limit or is implausible for the file.
    """

    def __init__(self, folder: Path) -> None:
        self._temporary: tempfile.TemporaryDirectory[str] | None = None
        self.databases = self._find_files(folder, ".db3")
        self.logs = [] if self.databases else self._find_files(folder, ".mcap")

    def close(self) -> None:
        """Remove the temporary folder. Idempotent."""
        if self._temporary is not None:
            self._temporary.cleanup()
            self._temporary = None

    def _find_files(self, folder: Path, suffix: str) -> list[Path]:
        plain, compressed = sorted(folder.glob(f"*{suffix}")), sorted(folder.glob(f"*{suffix}{_SUFFIX}"))
        for path in (*plain, *compressed):
            check_regular(path)
        return plain or [self._expand(path) for path in compressed]

    def _expand(self, compressed: Path) -> Path:
        if self._temporary is None:
            self._temporary = tempfile.TemporaryDirectory(prefix="hubodo-")
        plain = Path(self._temporary.name) / compressed.name.removesuffix(_SUFFIX)
        budgets = (
            file_budget(compressed, max_expanded_bytes(compressed.stat().st_size)),
            MemoryBudget(compressed),
        )
        try:
            with open_regular(compressed) as source, plain.open("wb") as target:
                reader = zstandard.ZstdDecompressor().stream_reader(source, read_across_frames=True)
                while part := reader.read(READ_BLOCK_BYTES):
                    for budget in budgets:
                        budget.claim(len(part), "its expanded content")
                    target.write(part)
        except zstandard.ZstdError as error:
            raise InputError(f"{compressed}: does not decompress ({error}); copy it again") from None
        return plain


def make_message_expander(folder: Path) -> Expander:
    """Return a function that expands one message of a bag; it raises ValueError for a damaged message."""
    size = sum(path.stat().st_size for path in folder.iterdir() if path.is_file())
    budget = file_budget(folder, max_expanded_bytes(size))

    def expand(data: bytes) -> bytes:
        limit = min(limit_bytes(), budget.limit - budget.claimed)
        try:
            claimed = zstandard.frame_content_size(data)
            if claimed > limit:
                check_claim(claimed, folder, "a message")
                budget.claim(claimed, "the sum of its messages")
            expanded = zstandard.ZstdDecompressor().decompress(data, max_output_size=max(1, limit))
        except zstandard.ZstdError as error:
            raise ValueError(f"a message does not decompress: {error}") from None
        budget.claim(len(expanded), "the sum of its messages")
        return expanded

    return expand
