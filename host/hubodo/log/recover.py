"""A log cut off or damaged to a whole one: every intact chunk, what decodes of the last, and an account."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from hubodo.atomic_files import atomic_new_file
from hubodo.errors import InputError
from hubodo.log.chunk_reader import Messages
from hubodo.log.logfile import Log
from hubodo.log.mcap_file import LIBRARY, PROFILE, Compression, McapFile
from hubodo.log.message_records import MESSAGE_HEADER
from hubodo.log.scan import scan

Progress = Callable[[str, float], None]
Indexes = dict[int, tuple[NDArray[np.int64], NDArray[np.int64]]]


@dataclass(frozen=True)
class RecoveryReport:
    """What `recover` did.

    messages: kept, by topic. start_ns, end_ns: log time of the first and last of them, None without any.
    bytes_lost: of the input, in damaged chunks and behind its last whole record. unknown: messages of
    channels that the file no longer tells about. was_whole: the input was closed and undamaged.
    losses: one line each.
    """

    path: Path
    out: Path
    messages: dict[str, int]
    start_ns: int | None
    end_ns: int | None
    t_zero_ns: int
    bytes_read: int
    bytes_lost: int
    chunks_kept: int
    chunks_lost: int
    unknown_channel_messages: int
    was_complete: bool
    losses: tuple[str, ...]


def recover_log(path: Path, out: Path, *, progress: Progress | None = None) -> RecoveryReport:
    """Rebuild a valid, indexed log from a damaged one.

    Raises LogError when the input holds nothing of an MCAP file, InputError when `out` exists. The input
    stays as it is; `out` appears only when it is complete.
    """
    path, out = Path(path), Path(out)
    if out.exists() and path.exists() and out.samefile(path):
        raise InputError(f"{out}: is the log itself; give another name, the damaged log is kept as it is")
    with atomic_new_file(out) as part, Log(scan(path, lenient=True)) as log:
        target = McapFile(part, profile=log.scan.profile or PROFILE, library=log.scan.library or LIBRARY)
        try:
            salvage = _Salvage(log, target)
            salvage.run(progress)
            target.finish()
        finally:
            target.close_without_footer()
        return salvage.account(out)


class _Salvage:
    def __init__(self, log: Log, target: McapFile) -> None:
        self.log, self.target = log, target
        self.known: set[int] = set()
        self.kept: Counter[int] = Counter()
        self.chunks_kept = 0
        self.unknown = 0
        self.span: tuple[int, int] | None = None

    def run(self, progress: Progress | None) -> None:
        found = self.log.scan
        for record in found.metadata:
            self.target.add_metadata(record.name, record.metadata)
        for file in found.attachments:
            self.target.add_attachment(file.name, file.media_type, file.data, file.log_time)
        self._announce()
        for messages in self.log.chunks():
            # A file that keeps its channels inside chunks tells of them only as it is read.
            self._announce()
            self._keep(messages)
            if progress:
                progress(f"recovering {found.path.name}", self.log.progress)
        lost = "; ".join(self.log.warnings()) or "nothing"
        self.target.add_metadata(
            "hubodo.recovered",
            {"from": found.path.name, "lost": lost, "messages": str(sum(self.kept.values()))},
        )

    def _announce(self) -> None:
        found = self.log.scan
        for channel in list(found.channels.values()):
            if channel.id in self.known:
                continue
            schema = found.schemas.get(channel.schema_id)
            if channel.schema_id and schema is None:
                continue
            if schema is not None:
                self.target.copy_schema(schema)
            self.target.copy_channel(channel)
            self.known.add(channel.id)

    def _keep(self, messages: Messages) -> None:
        channels: NDArray[np.int64] = messages.heads["channel"].astype(np.int64)
        possible = messages.heads["log_time"] >= 0  # beyond the year 2262 is damage, where no checksum told
        chosen = np.flatnonzero(np.isin(channels, list(self.known)) & possible)
        self.unknown += len(channels) - len(chosen)
        if not len(chosen):
            return
        places, heads = messages.places[chosen], messages.heads[chosen]
        sizes = heads["length"].astype(np.int64) + MESSAGE_HEADER.itemsize - 22
        raw = messages.data.tobytes()
        records = b"".join(
            [raw[start:end] for start, end in zip(places.tolist(), (places + sizes).tolist(), strict=True)]
        )
        offsets = np.cumsum(sizes) - sizes
        times: NDArray[np.int64] = heads["log_time"].astype(np.int64)
        indexes: Indexes = {}
        for id in np.unique(channels[chosen]).tolist():
            own = channels[chosen] == id
            indexes[id] = (times[own], offsets[own])
            self.kept[id] += int(own.sum())
        self.target.add_chunk(records, indexes, self._compression())
        self.chunks_kept += 1
        start, end = int(times.min()), int(times.max())
        self.span = (start, end) if self.span is None else (min(start, self.span[0]), max(end, self.span[1]))

    def _compression(self) -> Compression:
        used = next((place.compression for place in self.log.scan.chunks if place.compression), "none")
        return used if used in get_args(Compression) else "zstd"  # type: ignore[return-value]

    def account(self, out: Path) -> RecoveryReport:
        log, found = self.log, self.log.scan
        streams = log.streams
        messages: Counter[str] = Counter()
        for id, count in self.kept.items():
            messages[streams[id].topic] += count
        broken = {damage.offset for damage in found.damage}
        return RecoveryReport(
            path=found.path,
            out=out,
            messages=dict(sorted(messages.items())),
            start_ns=self.span[0] if self.span else None,
            end_ns=self.span[1] if self.span else None,
            t_zero_ns=log.t_zero_ns or 0,
            bytes_read=found.size,
            bytes_lost=sum(damage.length for damage in found.damage),
            chunks_kept=self.chunks_kept,
            chunks_lost=sum(place.offset in broken for place in found.chunks),
            unknown_channel_messages=self.unknown,
            was_complete=found.complete and not found.damage and not found.doubts,
            losses=log.warnings(),
        )
