"""ROS 2 messages compared with rosbags, an independent implementation."""

import dataclasses
import json
import struct
import types

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from hubodo.log import cdr_layouts, ros2

STORE = get_typestore(Stores.ROS2_HUMBLE)
ALL = (
    ros2.IMU,
    ros2.MAGNETIC_FIELD,
    ros2.TEMPERATURE,
    ros2.BATTERY,
    ros2.NAV_SAT_FIX,
    ros2.ODOMETRY,
    ros2.TWIST_STAMPED,
    ros2.TWIST_WITH_COVARIANCE_STAMPED,
    ros2.TF,
    ros2.FLOAT64_ARRAY,
)
FRAMES = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=12)


@pytest.mark.parametrize("name", [*ALL, ros2.UINT8_ARRAY, ros2.STRING])
def test_definitions_have_the_type_hash_of_ros2_humble(name: str) -> None:
    own = get_typestore(Stores.EMPTY)
    own.register(get_types_from_msg(ros2.definition(name), name))
    assert own.hash_rihs01(name) == STORE.hash_rihs01(name)


def create_record(layout: cdr_layouts.CdrLayout, seed: int) -> np.ndarray:
    """Return a record in which adjacent numbers differ, so that exchanged fields are detected."""
    rng = np.random.default_rng(seed)
    record = np.zeros(1, layout.dtype)  # numpy's copy() leaves padding bytes undefined
    record[0] = layout.template
    for name in layout.dtype.names or ():
        form = layout.dtype.fields[name][0]
        if name.endswith(".length") or name == "encapsulation" or form.base.kind == "V":
            continue
        if form.base.kind == "f":
            record[name] = rng.normal(size=form.shape)
        else:
            record[name] = rng.integers(0, 2 if form.base.kind == "b" else 100, size=form.shape)
    return record


def compare_fields(message: object, record: np.ndarray, prefix: str = "") -> int:
    """Compare each value of a decoded message with the field of the same path; return their number."""
    count = 0
    for field in dataclasses.fields(message):  # type: ignore[arg-type]
        value, path = getattr(message, field.name), prefix + field.name
        if field.name.isupper() or field.name == "__msgtype__":
            continue
        if dataclasses.is_dataclass(value):
            count += compare_fields(value, record, path + ".")
        elif isinstance(value, list):
            assert len(value) == record[path + ".length"][0]
            count += sum(compare_fields(item, record, f"{path}[{i}].") for i, item in enumerate(value))
        elif isinstance(value, str):
            assert record[path].tobytes() == value.encode() + b"\0"
            count += 1
        else:
            np.testing.assert_array_equal(np.asarray(value), record[path][0])
            count += 1
    return count


@pytest.mark.parametrize("name", ALL[:-1])
@given(frame=FRAMES, child=FRAMES, seed=st.integers(0, 2**32 - 1))
def test_rosbags_decodes_and_encodes_the_same_bytes(name: str, frame: str, child: str, seed: int) -> None:
    layout = cdr_layouts.stamped_layout(name, frame, child)
    record = create_record(layout, seed)
    message = STORE.deserialize_cdr(record.tobytes(), name)
    assert compare_fields(message, record) >= 5
    assert bytes(STORE.serialize_cdr(message, name)) == record.tobytes()


@given(count=st.integers(0, 9), seed=st.integers(0, 2**32 - 1))
def test_rows_of_columns_are_a_float64_multi_array_of_one_dimension(count: int, seed: int) -> None:
    layout = cdr_layouts.columns_layout([f"c{i}" for i in range(count)])
    record = create_record(layout, seed)
    record["layout.dim[0].size"], record["layout.dim[0].stride"], record["layout.data_offset"] = (
        count,
        count,
        0,
    )
    message = STORE.deserialize_cdr(record.tobytes(), ros2.FLOAT64_ARRAY)
    np.testing.assert_array_equal(message.data, record["data"][0])
    assert message.layout.dim[0].size == count
    assert json.loads(message.layout.dim[0].label) == [f"c{i}" for i in range(count)]
    assert bytes(STORE.serialize_cdr(message, ros2.FLOAT64_ARRAY)) == record.tobytes()


@pytest.mark.parametrize("name", ALL[:-1])
@given(frame=FRAMES, child=FRAMES)
def test_a_layout_derived_from_bytes_is_that_of_the_writer(name: str, frame: str, child: str) -> None:
    layout = cdr_layouts.stamped_layout(name, frame, child)
    assert cdr_layouts.infer_layout(name, layout.template.tobytes()).dtype == layout.dtype


@pytest.mark.parametrize("name", ALL)
@given(payload=st.binary(max_size=200))
def test_a_layout_of_random_bytes_is_found_or_raises_a_value_error(name: str, payload: bytes) -> None:
    try:
        form = cdr_layouts.infer_layout(name, b"\0\1\0\0" + payload)
    except ValueError:
        return
    assert form.dtype.itemsize <= len(payload) + 4


def test_a_length_beyond_the_message_is_refused_before_anything_is_allocated() -> None:
    payload = b"\0\1\0\0" + struct.pack("<I", 0xFFFFFFF0) + bytes(100)
    with pytest.raises(ValueError, match="claims 4294967280 elements"):
        cdr_layouts.infer_layout(ros2.TF, payload)


def test_layouts_of_big_endian_messages_are_derived() -> None:
    message = types.SimpleNamespace(seconds=7, frame=b"left\0", value=21.5)
    payload = b"\0\0\0\0" + struct.pack(
        ">iII5s3x4xdd", message.seconds, 9, 5, message.frame, message.value, 0.0
    )
    form = cdr_layouts.infer_layout(ros2.TEMPERATURE, payload)
    record = np.frombuffer(payload, form.dtype)[0]
    assert (record["header.stamp.sec"], record["temperature"]) == (7, 21.5)
