"""Decode ROS 2 messages into columns, all messages of one byte layout at once."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hubodo.log import cdr_layouts, ros2
from hubodo.log.chunk_reader import ChunkMessages
from hubodo.log.input_limits import MemoryBudget
from hubodo.log.message_records import MESSAGE_HEADER
from hubodo.units import NS_PER_S

TABLE_FIELDS: Mapping[str, tuple[str, ...]] = {
    ros2.IMU: ("angular_velocity", "linear_acceleration"),
    ros2.TEMPERATURE: ("temperature",),
    ros2.BATTERY: ("voltage",),
    ros2.MAGNETIC_FIELD: ("magnetic_field",),
    ros2.NAV_SAT_FIX: (
        "latitude",
        "longitude",
        "altitude",
        "position_covariance",
        "position_covariance_type",
        "status.status",
    ),
    ros2.ODOMETRY: (
        "pose.pose.position",
        "pose.pose.orientation",
        "twist.twist.linear",
        "twist.twist.angular",
    ),
    ros2.TWIST_STAMPED: ("twist.linear", "twist.angular"),
    ros2.TWIST_WITH_COVARIANCE_STAMPED: ("twist.twist.linear", "twist.twist.angular"),
    ros2.FLOAT64_ARRAY: ("data",),
}
"""Message types that become tables, and the decoded fields of each."""


@dataclass(frozen=True)
class ChannelRows:
    """The messages of a channel as arrays of equal length n, in file order.

    Attributes
    ----------
    sequence, log_ns, publish_ns, stamp_ns : (n,) int64; stamp_ns is the header stamp, else the publish time.
    values : field name -> (n,) or (n, k).
    undecodable : number of messages whose bytes do not match their type.
    label : label of the first dimension of a MultiArray ("" for other types); hubodo's own arrays hold the
        column names there.
    """

    sequence: NDArray[np.int64]
    log_ns: NDArray[np.int64]
    publish_ns: NDArray[np.int64]
    stamp_ns: NDArray[np.int64]
    values: Mapping[str, NDArray[np.float64]]
    undecodable: int
    label: str = ""

    def __len__(self) -> int:
        return len(self.sequence)

    def select(self, indices: NDArray[np.intp]) -> ChannelRows:
        """Return the rows with these indices, in this order."""
        return ChannelRows(
            self.sequence[indices],
            self.log_ns[indices],
            self.publish_ns[indices],
            self.stamp_ns[indices],
            {name: values[indices] for name, values in self.values.items()},
            self.undecodable,
            self.label,
        )


def normalise_type_name(schema: str) -> str:
    """Return the ROS 2 name of a type: `sensor_msgs/msg/Imu` for the ROS 1 name `sensor_msgs/Imu`."""
    package, _, name = schema.partition("/")
    return schema if "/" in name else f"{package}/msg/{name}"


def parse_column_names(text: str) -> list[str]:
    """Parse a JSON list of column names; return an empty list if it is damaged."""
    try:
        names = json.loads(text)
    except (ValueError, RecursionError):
        return []
    return [str(name) for name in names] if isinstance(names, list) else []


MAX_LAYOUT_CHANGES = 100_000
"""Number of layout changes, each parsed separately, after which a channel is no longer decoded."""
_MIN_WINDOW_MESSAGES, _MAX_WINDOW_MESSAGES = 64, 1 << 20  # messages
_ROW_OVERHEAD_BYTES = (
    150  # memory per message besides its numbers: header, stamps, order and their copies in `rows`
)


@dataclass
class ChannelDecoder:
    """A decoder that collects the messages of one channel chunk by chunk; `rows()` returns them all."""

    schema: str
    extra_fields: tuple[str, ...] = ()
    """Fields to decode besides those of `TABLE_FIELDS`."""
    budget: MemoryBudget | None = None
    """Memory budget for the decoded rows."""
    undecodable: int = 0
    label: str = ""
    _layout: cdr_layouts.ReceivedLayout | None = None
    _n_layouts: int = 0
    _window: int = _MAX_WINDOW_MESSAGES
    _n_fed: int = 0
    _runs: list[_DecodedRun] = field(default_factory=list)

    @property
    def _fields(self) -> tuple[str, ...]:
        return (*TABLE_FIELDS[self.schema], *self.extra_fields)

    def feed(self, messages: ChunkMessages, indices: NDArray[np.intp]) -> None:
        """Decode the messages with these indices, in this order."""
        sizes = messages.headers["length"][indices]
        first = self._n_fed
        self._n_fed += len(indices)
        # Messages of one layout have one size; where sizes alternate, each size is decoded as one run.
        if not len(indices) or sizes.min() == sizes.max():
            self._decode_run(messages, indices, first + np.arange(len(indices)))
            return
        by_size = np.argsort(sizes, kind="stable")
        runs = np.split(by_size, np.flatnonzero(np.diff(sizes[by_size])) + 1)
        for picked in sorted(runs, key=lambda run: int(run[0])):  # the first message decides the columns
            self._decode_run(messages, indices[picked], first + picked)

    def _decode_run(
        self, messages: ChunkMessages, indices: NDArray[np.intp], order: NDArray[np.intp]
    ) -> None:
        """Decode messages of one size. order: their positions among all messages of the channel."""
        done = 0
        while done < len(indices):
            # The window doubles while the layout fits: a change of layout must not cost a pass over the rest.
            part = indices[done : done + self._window]
            headers = messages.headers[part]
            starts = messages.offsets[part] + MESSAGE_HEADER.itemsize
            count = self._count_matching(messages, starts, headers["length"].astype(np.int64) - 22)
            if count:
                self._decode_fields(messages, headers[:count], starts[:count], order[done : done + count])
                done += count
                grown = min(2 * self._window, _MAX_WINDOW_MESSAGES)
                self._window = grown if count == len(part) else _MIN_WINDOW_MESSAGES
                continue
            self._window = _MIN_WINDOW_MESSAGES
            if self._n_layouts >= MAX_LAYOUT_CHANGES:
                self.undecodable += len(indices) - done
                return
            self._n_layouts += 1
            payload = messages.payload(int(indices[done]))
            try:
                self._layout = cdr_layouts.infer_layout(self.schema, payload)
                if not self._runs and "layout.dim[0].label" in (self._layout.dtype.names or ()):
                    self.label = self._layout.read_string(payload, "layout.dim[0].label")
            except ValueError:
                self.undecodable += 1
                done += 1

    def _count_matching(
        self, messages: ChunkMessages, starts: NDArray[np.int64], sizes: NDArray[np.int64]
    ) -> int:
        """Count the leading messages that match the current layout."""
        layout = self._layout
        if layout is None:
            return 0
        fits = (sizes >= layout.dtype.itemsize) & (sizes <= layout.dtype.itemsize + 3)
        count = len(fits) if fits.all() else int(fits.argmin())
        for name, expected in {"encapsulation": layout.encapsulation, **layout.lengths}.items():
            same = _gather_field(messages.data, starts[:count], layout.dtype, name) == expected
            count = count if same.all() else int(same.argmin())
        return count

    def _decode_fields(
        self,
        messages: ChunkMessages,
        headers: NDArray[np.void],
        starts: NDArray[np.int64],
        order: NDArray[np.intp],
    ) -> None:
        assert self._layout is not None
        dtype = self._layout.dtype
        if self.budget is not None:
            numbers = sum(self._layout.element_count(name) for name in self._fields)
            self.budget.claim(
                len(headers) * (_ROW_OVERHEAD_BYTES + 3 * 8 * numbers), "the array of its samples"
            )
        values = {
            name: _gather_field(messages.data, starts, dtype, name).astype(np.float64, copy=False)
            for name in self._fields
        }
        stamps = headers["publish_time"].astype(np.int64)
        if "header.stamp.sec" in (dtype.names or ()):
            seconds = _gather_field(messages.data, starts, dtype, "header.stamp.sec").astype(np.int64)
            nanoseconds = _gather_field(messages.data, starts, dtype, "header.stamp.nanosec").astype(np.int64)
            stated = seconds * NS_PER_S + nanoseconds
            stamps = np.where(stated == 0, stamps, stated)
        marks = np.stack(
            [
                headers["sequence"].astype(np.int64),
                headers["log_time"].astype(np.int64),
                headers["publish_time"].astype(np.int64),
                stamps,
            ]
        )
        self._runs.append(_DecodedRun(marks, values, order))

    def rows(self) -> ChannelRows:
        """Return all decoded messages; those with other array shapes than the first count as undecodable."""
        if not self._runs:
            none = np.empty(0, np.int64)
            return ChannelRows(none, none, none, none, {}, self.undecodable)
        shapes = [{name: values.shape[1:] for name, values in part.values.items()} for part in self._runs]
        parts = [part for part, shape in zip(self._runs, shapes, strict=True) if shape == shapes[0]]
        parts = _sort_runs(parts)
        marks = np.concatenate([part.marks for part in parts], axis=1)
        n_other_shape = sum(len(part.order) for part in self._runs) - marks.shape[1]
        sequence, log_ns, publish_ns, stamp_ns = marks
        return ChannelRows(
            sequence,
            log_ns,
            publish_ns,
            stamp_ns,
            {name: np.concatenate([part.values[name] for part in parts]) for name in self._fields},
            self.undecodable + n_other_shape,
            self.label,
        )


_STAMP_DTYPE = np.dtype(
    {"names": ["sec", "nanosec"], "formats": ["<u4", "<u4"], "offsets": [4, 8], "itemsize": 12}
)


def header_stamps(
    messages: ChunkMessages, indices: NDArray[np.intp], fallback_ns: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return the header stamps (n,) in ns of stamped messages, or `fallback_ns` if one is 0 or truncated."""
    stamps_ns = fallback_ns.copy()
    with_header = np.flatnonzero(messages.headers["length"][indices] >= 22 + _STAMP_DTYPE.itemsize)
    if not len(with_header):
        return stamps_ns
    starts = messages.offsets[indices[with_header]] + MESSAGE_HEADER.itemsize
    is_big_endian = messages.data[starts + 1] == 0
    parts = [
        _gather_field(messages.data, starts, _STAMP_DTYPE, name).view(np.uint32)
        for name in ("sec", "nanosec")
    ]
    seconds, nanoseconds = (np.where(is_big_endian, part.byteswap(), part) for part in parts)
    ns = seconds.view(np.int32).astype(np.int64) * NS_PER_S + nanoseconds
    stamps_ns[with_header] = np.where(ns == 0, stamps_ns[with_header], ns)
    return stamps_ns


class _DecodedRun(NamedTuple):
    """Messages of one size. marks: (4, n), sequence, log time, publish time and stamp."""

    marks: NDArray[np.int64]
    values: dict[str, NDArray[np.float64]]
    order: NDArray[np.intp]


def _sort_runs(parts: list[_DecodedRun]) -> list[_DecodedRun]:
    """Return the runs unchanged if they are in file order, else one run with all rows sorted."""
    if all(before.order[-1] < after.order[0] for before, after in pairwise(parts)):
        return parts
    order = np.concatenate([part.order for part in parts])
    rank = np.argsort(order)
    values = {name: np.concatenate([part.values[name] for part in parts])[rank] for name in parts[0].values}
    marks = np.concatenate([part.marks for part in parts], axis=1)[:, rank]
    return [_DecodedRun(marks, values, order[rank])]


def _gather_field(
    data: NDArray[np.uint8], starts: NDArray[np.int64], dtype: np.dtype[np.void], name: str
) -> NDArray[np.float64]:
    """Return one field of all messages, (n,) or (n, k), in the field's own type."""
    assert dtype.fields is not None
    part, offset = dtype.fields[name][:2]
    if part.itemsize == 0 or not len(starts):
        return np.empty((len(starts), *part.shape), part.base)
    field_at_byte: NDArray[np.void] = np.ndarray(
        (len(data) - offset - part.itemsize + 1,), f"V{part.itemsize}", data, offset, (1,)
    )
    picked = field_at_byte[starts]
    if part.subdtype is None:
        return picked.view(part)
    return picked.view(part.base).reshape(len(starts), -1)
