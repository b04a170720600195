"""Memory shared by a byte view for bus and link and an int16 view for arithmetic."""

try:
    from array import array

    import uctypes

    _ZEROS = [b""]

    def shared(words):
        """(raw, values): `words` int16, little-endian as the processor is, and the same memory as bytes."""
        if len(_ZEROS[0]) != 2 * words:
            # Cached, as two dozen slots of one size would leave as many zero strings as garbage.
            _ZEROS[0] = bytes(2 * words)
        values = array("h", _ZEROS[0])
        return uctypes.bytearray_at(uctypes.addressof(values), 2 * words), values

except ImportError:

    def shared(words):
        """(raw, values): `words` int16, little-endian as the processor is, and the same memory as bytes."""
        raw = bytearray(2 * words)
        return raw, memoryview(raw).cast("h")
