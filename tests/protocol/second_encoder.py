"""An independent encoder, written from protocol/README.md alone: simple, slow, without code of hubowire."""

# (field, bytes each, signed, count); bytes 0 stands for a byte string; the last entry of a table repeats.
PAYLOADS = {
    "Hello": (
        ("fingerprint", 4, False, 1),
        ("firmware", 1, False, 3),
        ("serial", 0, False, 8),
        ("boot_id", 2, False, 1),
        ("board", 1, False, 1),
        ("reset_cause", 1, False, 1),
        ("rate_mhz", 4, False, 1),
        ("gyro_range_dps", 2, False, 1),
        ("accel_range_g", 1, False, 1),
        ("gyro_lsb_ndps", 4, False, 1),
        ("accel_lsb_ng", 4, False, 1),
        ("temperature_lsb_udegc", 4, False, 1),
        ("temperature_offset_udegc", 4, True, 1),
        ("mag_lsb_ft", 4, False, 1),
        ("batch", 1, False, 1),
        ("filter_kind", 1, False, 1),
        ("stamp_bound_us", 2, False, 1),
    ),
    "ImuBatch": (
        ("t_us", 4, False, 1),
        ("period_ns", 4, False, 1),
        ("index", 2, False, 1),
        ("temperature_raw", 2, True, 1),
        ("flags", 1, False, 1),
    ),
    "Signal": (
        ("t_us", 4, False, 1),
        ("of_node", 1, False, 1),
        ("frames", 4, False, 1),
        ("frames_lost", 4, False, 1),
        ("pieces", 4, False, 1),
        ("pieces_twice", 4, False, 1),
        ("pieces_strong", 4, False, 1),
        ("rssi_dbm", 1, True, 1),
        ("requests_dropped", 2, False, 1),
    ),
    "HighG": (("t_us", 4, False, 1), ("period_ns", 4, False, 1), ("lsb_ng", 4, False, 1)),
    "Mag": (("t_us", 4, False, 1), ("field_raw", 2, True, 3)),
    "Filter": (
        ("t_us", 4, False, 1),
        ("state", 1, False, 1),
        ("saturations", 2, False, 1),
        ("samples", 4, False, 1),
        ("rate_q8", 4, True, 3),
        ("bias_q12", 4, True, 3),
        ("variance_q8", 4, False, 3),
        ("bias_sigma_q12", 4, False, 3),
    ),
    "Health": (
        ("t_us", 4, False, 1),
        ("battery_mv", 2, False, 1),
        ("faults", 2, False, 1),
        ("i2c_errors", 2, False, 1),
        ("bus_recoveries", 2, False, 1),
        ("fifo_overruns", 2, False, 1),
        ("samples_missed", 2, False, 1),
        ("frames_dropped", 2, False, 1),
        ("frames_damaged", 2, False, 1),
        ("queue_high_water", 1, False, 1),
        ("worst_loop_us", 4, False, 1),
        ("reset_cause", 1, False, 1),
        ("free_heap", 4, False, 1),
        ("stamp_bound_us", 2, False, 1),
        ("battery_percent", 1, False, 1),
    ),
    "Ack": (("request", 1, False, 1), ("request_seq", 2, False, 1)),
    "Nack": (
        ("request", 1, False, 1),
        ("request_seq", 2, False, 1),
        ("reason", 1, False, 1),
        ("detail", 4, True, 1),
    ),
    "TimeReply": (("token", 0, False, 8), ("received_us", 4, False, 1), ("sent_us", 4, False, 1)),
    "TimeRequest": (("token", 0, False, 8),),
    "Ping": (),
    "SetConfig": (("key", 1, False, 1), ("value", 4, True, 1)),
    "Start": (),
    "Stop": (),
    "BiasInit": (("samples", 2, False, 1),),
    "Reboot": (("mode", 1, False, 1),),
    "GetHello": (),
    "UpdateState": (
        ("status", 1, False, 1),
        ("slot", 1, False, 1),
        ("mpy", 2, False, 1),
        ("file", 2, False, 1),
        ("offset", 4, False, 1),
    ),
    "UpdateStart": (("slot", 1, False, 1), ("size", 4, False, 1), ("digest", 0, False, 32)),
    "UpdatePiece": (("file", 2, False, 1), ("offset", 4, False, 1)),
}
TABLES = {
    "Hello": ("parts", 1, False),
    "ImuBatch": ("samples", 2, True),
    "HighG": ("samples", 2, True),
    "UpdatePiece": ("data", 1, False),
}


def payload(message: str, values: dict) -> bytes:
    """Return the payload of field values as in a vector file."""
    out = b""
    for name, size, signed, count in PAYLOADS[message]:
        value = values[name]
        if size == 0:
            assert len(value) == 2 * count
            out += bytes.fromhex(value)
            continue
        for number in value if count > 1 else [value]:
            out += number.to_bytes(size, "little", signed=signed)
    if message in TABLES:
        name, size, signed = TABLES[message]
        out += bytes([len(values[name])])
        for row in values[name]:
            for number in row:
                out += number.to_bytes(size, "little", signed=signed)
    return out


def crc(data: bytes) -> int:
    """Return the CRC-16/CCITT-FALSE bit by bit, most significant bit first."""
    register = 0xFFFF
    for byte in data:
        for bit in range(7, -1, -1):
            feedback = (register >> 15) ^ (byte >> bit & 1)
            register = register << 1 & 0xFFFF
            if feedback:
                register ^= 0x1021
    return register


def cobs(data: bytes) -> bytes:
    """Return the COBS encoding, backwards: each zero becomes the distance to the next one."""
    out = [0, *data, 0]
    distance = 0
    for place in range(len(out) - 1, -1, -1):
        if out[place] == 0:
            out[place] = distance
            distance = 0
        distance += 1
    return bytes(out[:-1])


def frame(type_id: int, node: int, seq: int, body: bytes) -> bytes:
    """Return a frame with its delimiter."""
    checked = bytes([type_id, node, seq % 256, seq // 256]) + body
    value = crc(checked)
    return cobs(checked + bytes([value % 256, value // 256])) + b"\x00"
