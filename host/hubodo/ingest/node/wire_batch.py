"""IMU batches as received: header fields, raw samples as an array, and conversion to SI units."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hubodo.earth import STANDARD_GRAVITY
from hubowire.codec import payload_layout
from hubowire.messages import Hello, ImuBatch

RAD_PER_NANO_DEG = math.pi / 180 * 1e-9
_LAYOUT = payload_layout(ImuBatch)
_HEADER_STRUCT = _LAYOUT.fixed
assert _LAYOUT.rows is not None and _LAYOUT.rows.size == 12


class WireBatch(NamedTuple):
    """An `ImuBatch` with its samples as rows (sample_count, 6); first_index: sample number modulo 2^16."""

    t_us: int
    period_ns: int
    first_index: int
    temperature_raw: int
    flags: int
    sample_count: int
    rows: NDArray[np.int16]


def read_batch(payload: bytes) -> WireBatch | None:
    """Return the batch in a payload; None if the payload is too short."""
    if len(payload) < _HEADER_STRUCT.size:
        return None
    t_us, period_ns, first, temperature_raw, flags, count = _HEADER_STRUCT.unpack_from(payload)
    if len(payload) < _HEADER_STRUCT.size + 12 * count:
        return None
    rows = np.frombuffer(payload, "<i2", 6 * count, _HEADER_STRUCT.size).reshape(count, 6)
    return WireBatch(t_us, period_ns, first, temperature_raw, flags, count, rows)


def convert_to_si(rows: NDArray[np.int16], hello: Hello) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return raw samples (N, 6) as angular rates (N, 3), rad/s, and specific forces (N, 3), m/s²."""
    values = rows.astype(np.float64)
    flat = values.reshape(-1)
    room = 1 << max(len(rows) - 1, 0).bit_length()
    flat *= _lsb_values(hello.gyro_lsb_ndps, hello.accel_lsb_ng, room)[: len(flat)]
    return values[:, :3], values[:, 3:]


@lru_cache(maxsize=32)
def _lsb_values(gyro_lsb_ndps: int, accel_lsb_ng: int, samples: int) -> NDArray[np.float64]:
    """Return the scale of each value of `samples` samples as a flat array, the fastest to multiply with."""
    one = np.repeat([gyro_lsb_ndps * RAD_PER_NANO_DEG, accel_lsb_ng * 1e-9 * STANDARD_GRAVITY], 3)
    return np.tile(one, samples)
