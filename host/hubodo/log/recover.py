"""Recover a truncated or damaged log: copy every intact chunk and what decodes of the last."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from hubodo.atomic_files import atomic_new_file
from hubodo.errors import InputError
from hubodo.log.chunk_reader import ChunkMessages
from hubodo.log.logfile import Log
from hubodo.log.mcap_file import LIBRARY, PROFILE, Compression, McapFile
from hubodo.log.message_records import MESSAGE_HEADER
from hubodo.log.scan import scan_file
from hubodo.progress_callback import Progress

Indexes = dict[int, tuple[NDArray[np.int64], NDArray[np.int64]]]


@dataclass(frozen=True)
class RecoveryReport:
    """The result of a recovery.

    Attributes
    ----------
    messages : number of recovered messages by topic.
    start_ns, end_ns : log time of the first and last of them; None without any.
    bytes_lost : bytes of the input in damaged chunks and after its last complete record.
    unknown_channel_messages : messages lost because the definition of their channel is lost.
    was_complete : True if the input was closed and undamaged.
    losses : one line each.
    """

    path: Path
    out: Path
    messages: dict[str, int]
    start_ns: int | None
    end_ns: int | None
    t_zero_ns: int
    bytes_read: int
    bytes_lost: int
    chunks_recovered: int
    chunks_lost: int
    unknown_channel_messages: int
    was_complete: bool
    losses: tuple[str, ...]


def recover_log(path: Path, out: Path, *, progress: Progress | None = None) -> RecoveryReport:
    """Rebuild a valid, indexed log from a damaged one.

    Raises LogError if the input contains nothing of an MCAP file, InputError if `out` exists. The input is
    not modified; `out` appears only when complete.
    """
    path, out = Path(path), Path(out)
    if out.exists() and path.exists() and out.samefile(path):
        raise InputError(f"{out}: is the log itself; give another name, the damaged log is not modified")
    with atomic_new_file(out) as part, Log(scan_file(path, lenient=True)) as log:
        target = McapFile(part, profile=log.scan.profile or PROFILE, library=log.scan.library or LIBRARY)
        try:
            recovery = _Recovery(log, target)
            recovery.run(progress)
            target.finish()
        finally:
            target.close()
        return recovery.report(out)


class _Recovery:
    def __init__(self, log: Log, target: McapFile) -> None:
        self.log, self.target = log, target
        self.copied_channels: set[int] = set()
        self.message_counts: Counter[int] = Counter()
        self.chunks_recovered = 0
        self.unknown_channel_messages = 0
        self.span: tuple[int, int] | None = None

    def run(self, progress: Progress | None) -> None:
        scan = self.log.scan
        for record in scan.metadata:
            self.target.add_metadata(record.name, record.metadata)
        for file in scan.attachments:
            self.target.add_attachment(file.name, file.media_type, file.data, file.log_time)
        self._copy_definitions()
        for messages in self.log.chunks():
            # Channels stored inside chunks become known only as the chunks are read.
            self._copy_definitions()
            self._copy_messages(messages)
            if progress:
                progress(f"recovering {scan.path.name}", self.log.progress)
        lost = "; ".join(self.log.warnings()) or "nothing"
        self.target.add_metadata(
            "hubodo.recovered",
            {"from": scan.path.name, "lost": lost, "messages": str(sum(self.message_counts.values()))},
        )

    def _copy_definitions(self) -> None:
        scan = self.log.scan
        for channel in list(scan.channels.values()):
            if channel.id in self.copied_channels:
                continue
            schema = scan.schemas.get(channel.schema_id)
            if channel.schema_id and schema is None:
                continue
            if schema is not None:
                self.target.copy_schema(schema)
            self.target.copy_channel(channel)
            self.copied_channels.add(channel.id)

    def _copy_messages(self, messages: ChunkMessages) -> None:
        channels: NDArray[np.int64] = messages.headers["channel"].astype(np.int64)
        possible = messages.headers["log_time"] >= 0  # a time beyond 2262 is damage that no checksum revealed
        chosen = np.flatnonzero(np.isin(channels, list(self.copied_channels)) & possible)
        self.unknown_channel_messages += len(channels) - len(chosen)
        if not len(chosen):
            return
        offsets, headers = messages.offsets[chosen], messages.headers[chosen]
        sizes = headers["length"].astype(np.int64) + MESSAGE_HEADER.itemsize - 22
        raw = messages.data.tobytes()
        records = b"".join(
            [raw[start:end] for start, end in zip(offsets.tolist(), (offsets + sizes).tolist(), strict=True)]
        )
        offsets = np.cumsum(sizes) - sizes
        times: NDArray[np.int64] = headers["log_time"].astype(np.int64)
        indexes: Indexes = {}
        for id in np.unique(channels[chosen]).tolist():
            own = channels[chosen] == id
            indexes[id] = (times[own], offsets[own])
            self.message_counts[id] += int(own.sum())
        self.target.add_chunk(records, indexes, self._compression())
        self.chunks_recovered += 1
        start, end = int(times.min()), int(times.max())
        self.span = (start, end) if self.span is None else (min(start, self.span[0]), max(end, self.span[1]))

    def _compression(self) -> Compression:
        used = next((place.compression for place in self.log.scan.chunks if place.compression), "none")
        return used if used in get_args(Compression) else "zstd"  # type: ignore[return-value]

    def report(self, out: Path) -> RecoveryReport:
        log, scan = self.log, self.log.scan
        streams = log.streams
        messages: Counter[str] = Counter()
        for id, count in self.message_counts.items():
            messages[streams[id].topic] += count
        broken = {damage.offset for damage in scan.damage}
        return RecoveryReport(
            path=scan.path,
            out=out,
            messages=dict(sorted(messages.items())),
            start_ns=self.span[0] if self.span else None,
            end_ns=self.span[1] if self.span else None,
            t_zero_ns=log.t_zero_ns or 0,
            bytes_read=scan.size,
            bytes_lost=sum(damage.length for damage in scan.damage),
            chunks_recovered=self.chunks_recovered,
            chunks_lost=sum(place.offset in broken for place in scan.chunks),
            unknown_channel_messages=self.unknown_channel_messages,
            was_complete=scan.complete and not scan.damage and not scan.checksum_failures,
            losses=log.warnings(),
        )
