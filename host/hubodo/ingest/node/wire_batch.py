"""A batch of samples as it came: its head, its rows as an array, and what a step of them is worth."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hubodo.ingest.node.scale import RAD_PER_NANO_DEG, G
from hubowire.codec import layout
from hubowire.messages import Hello, ImuBatch

_LAYOUT = layout(ImuBatch)
_HEAD = _LAYOUT.fixed
assert _LAYOUT.rows is not None and _LAYOUT.rows.size == 12


class WireBatch(NamedTuple):
    """An `ImuBatch`, its samples not taken apart; first: the number of the first, rows: (samples, 6)."""

    t_us: int
    period_ns: int
    first: int
    temperature_raw: int
    flags: int
    samples: int
    rows: NDArray[np.int16]


def read_batch(payload: bytes) -> WireBatch | None:
    """The batch in a payload; None where it is too short."""
    if len(payload) < _HEAD.size:
        return None
    t_us, period_ns, first, temperature_raw, flags, count = _HEAD.unpack_from(payload)
    if len(payload) < _HEAD.size + 12 * count:
        return None
    rows = np.frombuffer(payload, "<i2", 6 * count, _HEAD.size).reshape(count, 6)
    return WireBatch(t_us, period_ns, first, temperature_raw, flags, count, rows)


def in_si(rows: NDArray[np.int16], hello: Hello) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Raw samples (N, 6) as angular rates (N, 3), rad/s, and specific forces (N, 3), m/s²."""
    values = rows.astype(np.float64)
    flat = values.reshape(-1)
    room = 1 << max(len(rows) - 1, 0).bit_length()
    flat *= _steps(hello.gyro_lsb_ndps, hello.accel_lsb_ng, room)[: len(flat)]
    return values[:, :3], values[:, 3:]


@lru_cache(maxsize=32)
def _steps(gyro_lsb_ndps: int, accel_lsb_ng: int, samples: int) -> NDArray[np.float64]:
    """What a step of each value of so many samples is worth: one product of two rows is the quickest."""
    one = np.repeat([gyro_lsb_ndps * RAD_PER_NANO_DEG, accel_lsb_ng * 1e-9 * G], 3)
    return np.tile(one, samples)
