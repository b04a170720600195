"""The checksums that a log has beside those of its chunks: of each attachment, and of all up to its end."""

from __future__ import annotations

import zlib
from collections.abc import Iterable

from hubodo.log.descriptor import pread

_BLOCK = 1 << 20


def attachment_holds(content: bytes) -> bool:
    """Whether the content of an attachment record is what its last four bytes say; 0: they say nothing."""
    stated = int.from_bytes(content[-4:], "little")
    return not stated or zlib.crc32(content[:-4]) == stated


def data_section_holds(fd: int, starts: Iterable[int], end: int, stated: int) -> bool:
    """Whether the bytes up to `end` have the stated checksum; 0: not given.

    starts: where writers begin to count: most at the first byte, some behind the magic or the header.
    """
    return not stated or any(_checksum(fd, start, end) == stated for start in starts)


def _checksum(fd: int, start: int, end: int) -> int:
    crc = 0
    while start < end and (block := pread(fd, min(_BLOCK, end - start), start)):
        crc = zlib.crc32(block, crc)
        start += len(block)
    return crc
