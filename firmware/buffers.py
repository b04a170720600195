"""Memory that is bytes to a bus or a link and 16-bit integers to arithmetic, without a copy between them."""

try:
    from array import array

    import uctypes

    _ZEROS = [b""]

    def shared(words):
        """(raw, values): `words` int16, little-endian as the processor is, and the same memory as bytes."""
        if len(_ZEROS[0]) != 2 * words:
            # Kept for the next: two dozen slots of one size would leave as many zeros as garbage.
            _ZEROS[0] = bytes(2 * words)
        values = array("h", _ZEROS[0])
        return uctypes.bytearray_at(uctypes.addressof(values), 2 * words), values

except ImportError:

    def shared(words):
        """(raw, values): `words` int16, little-endian as the processor is, and the same memory as bytes."""
        raw = bytearray(2 * words)
        return raw, memoryview(raw).cast("h")
