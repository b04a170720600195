"""Records of messages, alone and in rows."""

import io
import struct

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.records import Message

from hubodo.log import cdr_layouts, ros2
from hubodo.log.message_records import MESSAGE_HEADER, RowBuffer, encode_message_record


def test_a_record_is_what_the_mcap_package_reads():
    record = encode_message_record(7, 3, 100, 90, b"payload")
    assert record[0] == 5 and int.from_bytes(record[1:9], "little") == len(record) - 9
    message = Message.read(ReadDataStream(io.BytesIO(record[9:])), len(record) - 9)
    assert (message.channel_id, message.sequence, message.log_time, message.publish_time) == (7, 3, 100, 90)
    assert message.data == b"payload"


def test_a_row_of_a_buffer_has_the_bytes_of_a_single_record():
    layout = cdr_layouts.stamped_layout(ros2.TEMPERATURE, "left")
    buffer = RowBuffer(7, layout, "header.")
    buffer.field_view("temperature")[:2] = [20.5, 21.5]
    buffer.log_time[:2], buffer.publish_time[:2], buffer.sequence[:2] = [100, 200], [90, 190], [3, 4]
    payload = bytearray(layout.template.tobytes())
    struct.pack_into("<d", payload, layout.dtype.fields["temperature"][1], 21.5)
    assert buffer.rows[1:2].tobytes() == encode_message_record(7, 4, 200, 190, bytes(payload))
    assert buffer.record_size == MESSAGE_HEADER.itemsize + layout.dtype.itemsize
    assert np.shares_memory(buffer.field_view("temperature"), buffer.rows)
