"""Check the CRCs of an MCAP file outside its chunks: of each attachment and of the data section."""

from __future__ import annotations

import zlib
from collections.abc import Iterable

from hubodo.log.descriptor import pread
from hubodo.log.input_limits import READ_BLOCK_BYTES


def attachment_crc_matches(content: bytes) -> bool:
    """Return True if an attachment record matches the CRC in its last four bytes, or if that is 0 (none)."""
    expected_crc = int.from_bytes(content[-4:], "little")
    return not expected_crc or zlib.crc32(content[:-4]) == expected_crc


def data_section_crc_matches(fd: int, starts: Iterable[int], end: int, expected_crc: int) -> bool:
    """Return True if the bytes up to offset `end` match the expected CRC, or if that is 0 (not given).

    starts: offsets at which the CRC may begin: most writers use the first byte of the file, some the first
    after the magic bytes or the header.
    """
    return not expected_crc or any(_compute_crc(fd, start, end) == expected_crc for start in starts)


def _compute_crc(fd: int, start: int, end: int) -> int:
    crc = 0
    while start < end and (block := pread(fd, min(READ_BLOCK_BYTES, end - start), start)):
        crc = zlib.crc32(block, crc)
        start += len(block)
    return crc
