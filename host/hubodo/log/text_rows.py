"""Rows of a text file: unpacked, decoded, without comments, within the limit of a row's length."""

from __future__ import annotations

import codecs
import gzip
import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import cast

from hubodo.errors import InputError
from hubodo.log.input_limits import open_regular

_GZIP_MAGIC = b"\x1f\x8b"
COMMENT_MARKS = "#%"
_COMMENT_STARTS = (*COMMENT_MARKS, "//")
_UTF16_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
_HEAD_BYTES = 4096
MAX_ROW_CHARS = 1 << 20  # a longer row does not consist of numbers
NumberedRow = tuple[int, str]
"""Row number in the file, counted from 1, and text of the row."""


def iterate_rows(path: Path, first: int = 1) -> Iterator[NumberedRow]:
    """Yield the rows from number `first` on, without blanks and comments. Raises InputError if not text."""
    with open_text(path) as text:
        number = 0
        try:
            while line := text.readline(MAX_ROW_CHARS + 1):
                number += 1
                if len(line) > MAX_ROW_CHARS:
                    raise InputError(
                        f"{path}: row {number} is longer than {MAX_ROW_CHARS} characters; split it"
                    )
                content = line.strip()
                if number >= first and content and not content.startswith(_COMMENT_STARTS):
                    yield number, content
        except UnicodeDecodeError:
            raise InputError(
                f"{path}: row {number + 1} or the rows after it are not UTF-8 text; convert the file, and "
                "unpack it where it is a compressed file of another kind"
            ) from None


@contextmanager
def open_text(path: Path) -> Iterator[io.TextIOWrapper]:
    """Open a file as text in the encoding of its first bytes."""
    with open_stream(path) as stream:
        encoding = _encoding(stream.peek(_HEAD_BYTES)[:_HEAD_BYTES])
        yield io.TextIOWrapper(stream, encoding)


def _encoding(head: bytes) -> str:
    """Return the encoding by the first bytes: that of Windows if letters of the header are not UTF-8."""
    if head.startswith(_UTF16_MARKS):
        return "utf-16"
    if bare := unmarked_utf16(head):
        return bare
    header = re.split(rb"[\r\n]+[-+ \t]*\d", head)[0]
    try:
        header.decode("utf-8-sig")
    except UnicodeDecodeError:
        return "utf-8-sig" if b"\0" in head else "cp1252"
    return "utf-8-sig"


def is_utf16(head: bytes) -> bool:
    """Return True if the first bytes are those of UTF-16, with or without a byte order mark."""
    return head.startswith(_UTF16_MARKS) or bool(unmarked_utf16(head))


def unmarked_utf16(head: bytes) -> str:
    """Return the encoding of UTF-16 without a byte order mark, of which every other byte is 0; else ""."""
    for first, encoding in ((1, "utf-16-le"), (0, "utf-16-be")):
        zeros, others = head[first::2], head[1 - first :: 2]
        if len(head) > 1 and zeros.count(0) > 0.9 * len(zeros) and not others.count(0):
            return encoding
    return ""


@contextmanager
def open_stream(path: Path) -> Iterator[gzip.GzipFile | io.BufferedReader]:
    """Open a file for reading, unpacked where it is gzipped."""
    with open_regular(path) as file:
        packed = file.read(2) == _GZIP_MAGIC
        file.seek(0)
        if packed:
            with gzip.GzipFile(fileobj=file) as stream:
                yield stream
        else:
            yield io.BufferedReader(cast(io.RawIOBase, file))
