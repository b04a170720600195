"""Batches of inertial samples as received, and their conversion to SI units."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fakes.node_messages import hello
from hubodo.ingest.node.wire_batch import convert_to_si, read_batch
from hubowire import decode, encode
from hubowire.messages import ImuBatch

_INT16 = st.integers(-32768, 32767)
_SAMPLES = st.lists(st.tuples(*[_INT16] * 6), max_size=19).map(tuple)


@given(_SAMPLES, st.integers(0, 2**30 - 1), st.integers(0, 65535), st.integers(0, 15))
def test_a_batch_is_read_as_the_codec_decodes_it(
    samples: tuple[tuple[int, ...], ...], t_us: int, index: int, flags: int
) -> None:
    message = ImuBatch(t_us, 2_403_846, index, -123, flags, samples)
    payload = encode(message)
    batch = read_batch(payload)
    assert batch is not None
    assert decode(ImuBatch.type_id, payload) == ImuBatch(
        batch.t_us,
        batch.period_ns,
        batch.first_index,
        batch.temperature_raw,
        batch.flags,
        tuple(map(tuple, batch.rows.tolist())),
    )
    assert batch.sample_count == len(samples)


def test_a_payload_that_ends_within_a_batch_is_no_batch() -> None:
    payload = encode(ImuBatch(1, 2, 3, 4, 0, ((1, 2, 3, 4, 5, 6), (7, 8, 9, 10, 11, 12))))
    assert read_batch(payload) is not None
    for size in range(len(payload)):
        assert read_batch(payload[:size]) is None, size


def test_one_count_of_an_lsm6ds33_is_70_mdps_and_0_488_mg() -> None:
    """Sensitivities of its data sheet at 2000 deg/s and 16 g; 1 g is 9.80665 m/s²."""
    gyro, accel = convert_to_si(np.array([[1, -2, 3, 1, -2, 3]], np.int16), hello())
    assert gyro == pytest.approx(0.070 * math.pi / 180 * np.array([[1, -2, 3]]), rel=1e-12)
    assert accel == pytest.approx(0.488e-3 * 9.80665 * np.array([[1, -2, 3]]), rel=1e-12)


def test_the_scale_of_a_sample_does_not_depend_on_the_length_of_its_block() -> None:
    rows = np.random.default_rng(5).integers(-32768, 32768, (37, 6)).astype(np.int16)
    gyro, accel = convert_to_si(rows, hello())
    for first, last in ((0, 1), (1, 4), (4, 37), (5, 5)):
        part = convert_to_si(rows[first:last], hello())
        assert np.array_equal(part[0], gyro[first:last])
        assert np.array_equal(part[1], accel[first:last])
