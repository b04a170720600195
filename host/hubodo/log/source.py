"""What a file of messages is to its readers, be it MCAP or a rosbag."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from hubodo.log import topics
from hubodo.log.chunk_reader import Messages


@dataclass(frozen=True)
class Stream:
    """A channel: its topic, the type of its messages (`schema`), how they are encoded."""

    id: int
    topic: str
    schema: str
    encoding: str
    metadata: Mapping[str, str]


@dataclass(frozen=True)
class FileInfo:
    """What `hubodo info` tells of a file. size: bytes; complete: whether it was closed.

    attachments: bytes of each file kept in it. damaged: places that could not be used or trusted.
    """

    size: int
    library: str
    profile: str
    complete: bool
    attachments: Mapping[str, int] = field(default_factory=dict)
    damaged: int = 0


class MessageSource(Protocol):
    """Messages by channel, and what the file says besides; `chunks` makes all of it whole."""

    @property
    def path(self) -> Path: ...
    @property
    def file_info(self) -> FileInfo: ...
    @property
    def streams(self) -> Mapping[int, Stream]: ...
    @property
    def metadata_records(self) -> Mapping[str, Mapping[str, str]]: ...
    @property
    def metadata(self) -> Mapping[str, str]: ...
    @property
    def t_zero_ns(self) -> int | None: ...
    @property
    def progress(self) -> float: ...
    def chunks(self) -> Iterator[Messages]: ...
    def warnings(self) -> tuple[str, ...]: ...


def is_hubodo_log(source: MessageSource) -> bool:
    """Whether hubodo wrote a log: by its metadata, or, in a copy that lost them, by its topics."""
    own = any(stream.topic.startswith(topics.HUBODO_PREFIX) for stream in source.streams.values())
    return own or topics.METADATA_RECORD in source.metadata_records
