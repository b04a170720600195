"""Schemas, channels, metadata and attachments that each log of a series repeats."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from mcap.records import Channel, Schema

from hubodo.log.mcap_file import McapFile


class LogDefinitions:
    """The definitions of a recording, written to each log in the order that MCAP prescribes."""

    def __init__(self) -> None:
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._metadata: dict[str, dict[str, str]] = {}
        self._attachments: dict[str, tuple[str, bytes, int]] = {}
        self._written_schemas: set[int] = set()
        self._written_channels: set[int] = set()

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Register a schema, and return its id."""
        schema = Schema(id=len(self._schemas) + 1, name=name, encoding=encoding, data=data)
        self._schemas[schema.id] = schema
        return schema.id

    def add_channel(self, topic: str, encoding: str, schema_id: int, metadata: Mapping[str, str]) -> int:
        """Register a channel, and return its id."""
        number = len(self._channels) + 1
        self._channels[number] = Channel(
            id=number,
            topic=topic,
            message_encoding=encoding,
            schema_id=schema_id,
            metadata=dict(metadata),
        )
        return number

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Register a metadata record; it replaces one of the same name."""
        self._metadata[name] = dict(values)

    def add_attachment(self, name: str, media_type: str, data: bytes, time_ns: int) -> None:
        """Register an attached file; it replaces one of the same name."""
        self._attachments[name] = (media_type, data, time_ns)

    def begin_log(self, file: McapFile) -> None:
        """Write metadata and attachments to a new log; its schemas and channels follow on first use."""
        for name, values in self._metadata.items():
            file.add_metadata(name, values)
        for name, (media_type, data, time_ns) in self._attachments.items():
            file.add_attachment(name, media_type, data, time_ns)
        self._written_schemas.clear()
        self._written_channels.clear()

    def write_channels(self, file: McapFile, numbers: Iterable[int]) -> None:
        """Write those channels, each preceded by its schema, that the log lacks."""
        for number in sorted(set(numbers) - self._written_channels):
            channel = self._channels[number]
            if channel.schema_id and channel.schema_id not in self._written_schemas:
                file.copy_schema(self._schemas[channel.schema_id])
                self._written_schemas.add(channel.schema_id)
            file.copy_channel(channel)
            self._written_channels.add(number)
