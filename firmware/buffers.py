"""Memory shared by a byte view for bus and link and an int16 view for arithmetic."""

try:
    from array import array

    import uctypes

    _ZEROS = [b""]

    def shared(words):
        """Return (raw, values): a byte view and an int16 view (little-endian) of the same `words` words."""
        if len(_ZEROS[0]) != 2 * words:
            # Cached, as two dozen slots of one size would leave as many zero strings as garbage.
            _ZEROS[0] = bytes(2 * words)
        values = array("h", _ZEROS[0])
        return uctypes.bytearray_at(uctypes.addressof(values), 2 * words), values

except ImportError:

    def shared(words):
        """Return (raw, values): a byte view and an int16 view (little-endian) of the same `words` words."""
        raw = bytearray(2 * words)
        return raw, memoryview(raw).cast("h")
