"""ROS 2 messages to columns: all messages of a channel at once, grouped by their byte layout."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hubodo.log import ros2
from hubodo.log.chunk_reader import Messages
from hubodo.log.input_limits import MemoryBudget
from hubodo.log.message_records import MESSAGE_HEADER
from hubodo.units import NS_PER_S

WANTED: Mapping[str, tuple[str, ...]] = {
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
    ros2.COLUMNS: ("data",),
}
"""The message types that become tables, and the fields taken out of each."""


@dataclass(frozen=True)
class ChannelRows:
    """A channel's messages as arrays of equal length n, in file order.

    sequence, log_ns, publish_ns, stamp_ns: (n,) int64; stamp is the header's, else the publish time.
    values: field -> (n,) or (n, k). undecodable: messages whose bytes do not fit their type. label: of the
    first dimension of an array, "" of other types: ours has the names of its columns.
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

    def take(self, chosen: NDArray[np.intp]) -> ChannelRows:
        """The rows with these indices, in this order."""
        return ChannelRows(
            self.sequence[chosen],
            self.log_ns[chosen],
            self.publish_ns[chosen],
            self.stamp_ns[chosen],
            {name: values[chosen] for name, values in self.values.items()},
            self.undecodable,
            self.label,
        )


def message_type(schema: str) -> str:
    """The ROS 2 spelling of a type: `sensor_msgs/Imu`, as some writers have it, is `sensor_msgs/msg/Imu`."""
    package, _, name = schema.partition("/")
    return schema if "/" in name else f"{package}/msg/{name}"


def column_names(text: str) -> list[str]:
    """Column names from their JSON list; none when it is damaged."""
    try:
        names = json.loads(text)
    except (ValueError, RecursionError):
        return []
    return [str(name) for name in names] if isinstance(names, list) else []


MOST_LAYOUTS = 100_000
"""Changes of layout, each of which is parsed by itself, after which a channel is no longer decoded."""
_LEAST_WINDOW, _LARGEST_WINDOW = 64, 1 << 20  # messages
_ROW_BYTES = 150  # of memory per message besides its numbers: head, stamps, order, and their copies in `rows`


@dataclass
class Decoder:
    """Collects the messages of one channel chunk by chunk; `rows()` gives them all."""

    schema: str
    more: tuple[str, ...] = ()
    """Fields besides those of WANTED."""
    budget: MemoryBudget | None = None
    """Of what is kept."""
    undecodable: int = 0
    label: str = ""
    _form: ros2.Form | None = None
    _n_measured: int = 0
    _window: int = _LARGEST_WINDOW
    _fed: int = 0
    _parts: list[_Part] = field(default_factory=list)

    @property
    def _fields(self) -> tuple[str, ...]:
        return (*WANTED[self.schema], *self.more)

    def feed(self, messages: Messages, chosen: NDArray[np.intp]) -> None:
        """Take in the messages with these indices, in this order."""
        sizes = messages.heads["length"][chosen]
        first = self._fed
        self._fed += len(chosen)
        # Messages of one layout have one size; where sizes alternate, each size is decoded as one run.
        if not len(chosen) or sizes.min() == sizes.max():
            self._feed_run(messages, chosen, first + np.arange(len(chosen)))
            return
        by_size = np.argsort(sizes, kind="stable")
        runs = np.split(by_size, np.flatnonzero(np.diff(sizes[by_size])) + 1)
        for picked in sorted(runs, key=lambda run: int(run[0])):  # the first message decides on the columns
            self._feed_run(messages, chosen[picked], first + picked)

    def _feed_run(self, messages: Messages, chosen: NDArray[np.intp], order: NDArray[np.intp]) -> None:
        """Decode messages of one size. order: their places among all messages of the channel."""
        done = 0
        while done < len(chosen):
            # The window doubles while the layout fits: a change of layout must not cost a pass over the rest.
            part = chosen[done : done + self._window]
            heads = messages.heads[part]
            starts = messages.places[part] + MESSAGE_HEADER.itemsize
            count = self._fitting(messages, starts, heads["length"].astype(np.int64) - 22)
            if count:
                self._decode(messages, heads[:count], starts[:count], order[done : done + count])
                done += count
                grown = min(2 * self._window, _LARGEST_WINDOW)
                self._window = grown if count == len(part) else _LEAST_WINDOW
                continue
            self._window = _LEAST_WINDOW
            if self._n_measured >= MOST_LAYOUTS:
                self.undecodable += len(chosen) - done
                return
            self._n_measured += 1
            payload = messages.payload(int(chosen[done]))
            try:
                self._form = ros2.measure(self.schema, payload)
                if not self._parts and "layout.dim[0].label" in (self._form.dtype.names or ()):
                    self.label = self._form.text(payload, "layout.dim[0].label")
            except ValueError:
                self.undecodable += 1
                done += 1

    def _fitting(self, messages: Messages, starts: NDArray[np.int64], sizes: NDArray[np.int64]) -> int:
        """How many messages from the first on have the layout at hand."""
        form = self._form
        if form is None:
            return 0
        fits = (sizes >= form.dtype.itemsize) & (sizes <= form.dtype.itemsize + 3)
        count = len(fits) if fits.all() else int(fits.argmin())
        for name, expected in {"encapsulation": form.encapsulation, **form.lengths}.items():
            same = _gather(messages.data, starts[:count], form.dtype, name) == expected
            count = count if same.all() else int(same.argmin())
        return count

    def _decode(
        self,
        messages: Messages,
        heads: NDArray[np.void],
        starts: NDArray[np.int64],
        order: NDArray[np.intp],
    ) -> None:
        assert self._form is not None
        form = self._form.dtype
        if self.budget is not None:
            numbers = sum(self._form.count_of(name) for name in self._fields)
            self.budget.claim(len(heads) * (_ROW_BYTES + 3 * 8 * numbers), "the array of its samples")
        values = {
            name: _gather(messages.data, starts, form, name).astype(np.float64, copy=False)
            for name in self._fields
        }
        stamps = heads["publish_time"].astype(np.int64)
        if "header.stamp.sec" in (form.names or ()):
            seconds = _gather(messages.data, starts, form, "header.stamp.sec").astype(np.int64)
            nanoseconds = _gather(messages.data, starts, form, "header.stamp.nanosec").astype(np.int64)
            stated = seconds * NS_PER_S + nanoseconds
            stamps = np.where(stated == 0, stamps, stated)
        self._parts.append(_Part(heads, stamps, values, order))

    def rows(self) -> ChannelRows:
        """All messages taken in; those with another number of values than the first count as undecodable."""
        if not self._parts:
            none = np.empty(0, np.int64)
            return ChannelRows(none, none, none, none, {}, self.undecodable)
        shapes = [{name: values.shape[1:] for name, values in part.values.items()} for part in self._parts]
        parts = [part for part, shape in zip(self._parts, shapes, strict=True) if shape == shapes[0]]
        parts = _in_order(parts)
        heads = np.concatenate([part.heads for part in parts])
        odd = sum(len(part.heads) for part in self._parts) - len(heads)
        return ChannelRows(
            heads["sequence"].astype(np.int64),
            heads["log_time"].astype(np.int64),
            heads["publish_time"].astype(np.int64),
            np.concatenate([part.stamps for part in parts]),
            {name: np.concatenate([part.values[name] for part in parts]) for name in self._fields},
            self.undecodable + odd,
            self.label,
        )


_STAMP = np.dtype({"names": ["sec", "nanosec"], "formats": ["<u4", "<u4"], "offsets": [4, 8], "itemsize": 12})


def stamps(messages: Messages, chosen: NDArray[np.intp], otherwise: NDArray[np.int64]) -> NDArray[np.int64]:
    """Header stamps, (n,) ns, of messages that begin with a header; `otherwise` where one is 0 or cut off."""
    stated = otherwise.copy()
    whole = np.flatnonzero(messages.heads["length"][chosen] >= 22 + _STAMP.itemsize)
    if not len(whole):
        return stated
    starts = messages.places[chosen[whole]] + MESSAGE_HEADER.itemsize
    big = messages.data[starts + 1] == 0
    parts = [_gather(messages.data, starts, _STAMP, name).view(np.uint32) for name in ("sec", "nanosec")]
    seconds, nanoseconds = (np.where(big, part.byteswap(), part) for part in parts)
    ns = seconds.view(np.int32).astype(np.int64) * NS_PER_S + nanoseconds
    stated[whole] = np.where(ns == 0, stated[whole], ns)
    return stated


class _Part(NamedTuple):
    heads: NDArray[np.void]
    stamps: NDArray[np.int64]
    values: dict[str, NDArray[np.float64]]
    order: NDArray[np.intp]


def _in_order(parts: list[_Part]) -> list[_Part]:
    """Return the parts as they are where they follow each other, else one with all rows in file order."""
    if all(before.order[-1] < after.order[0] for before, after in pairwise(parts)):
        return parts
    order = np.concatenate([part.order for part in parts])
    rank = np.argsort(order)
    values = {name: np.concatenate([part.values[name] for part in parts])[rank] for name in parts[0].values}
    heads, stamps = (
        np.concatenate([part.heads for part in parts])[rank],
        np.concatenate([part.stamps for part in parts])[rank],
    )
    return [_Part(heads, stamps, values, order[rank])]


def _gather(
    data: NDArray[np.uint8], starts: NDArray[np.int64], form: np.dtype[np.void], name: str
) -> NDArray[np.float64]:
    """One field of all messages: (n,) or (n, k), in the field's own type."""
    assert form.fields is not None
    part, offset = form.fields[name][:2]
    if part.itemsize == 0 or not len(starts):
        return np.empty((len(starts), *part.shape), part.base)
    anywhere: NDArray[np.void] = np.ndarray(
        (len(data) - offset - part.itemsize + 1,), f"V{part.itemsize}", data, offset, (1,)
    )
    picked = anywhere[starts]
    if part.subdtype is None:
        return picked.view(part)
    return picked.view(part.base).reshape(len(starts), -1)
