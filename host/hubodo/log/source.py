"""Common interface of message files: MCAP and rosbags."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from hubodo.log import topics
from hubodo.log.chunk_reader import ChunkMessages


@dataclass(frozen=True)
class Stream:
    """A channel: topic, message type (`schema`) and encoding."""

    id: int
    topic: str
    schema: str
    encoding: str
    metadata: Mapping[str, str]


@dataclass(frozen=True)
class FileInfo:
    """General information about a file, for `hubodo info`.

    Attributes
    ----------
    size : bytes.
    library, profile : library and profile of the writer.
    complete : True if the file was closed.
    attachments : size of each attached file, bytes.
    damaged : number of damaged parts.
    """

    size: int
    library: str
    profile: str
    complete: bool
    attachments: Mapping[str, int] = field(default_factory=dict)
    damaged: int = 0


class MessageSource(Protocol):
    """A readable file of messages; its other properties are complete once `chunks` has finished."""

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
    def chunks(self) -> Iterator[ChunkMessages]: ...
    def warnings(self) -> tuple[str, ...]: ...


def is_hubodo_log(source: MessageSource) -> bool:
    """Return True if hubodo wrote a log, by its metadata or, in a copy without them, by its topics."""
    own = any(stream.topic.startswith(topics.HUBODO_PREFIX) for stream in source.streams.values())
    return own or topics.METADATA_RECORD in source.metadata_records
