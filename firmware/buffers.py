"""Memory that is bytes to a bus or a link and 16-bit integers to arithmetic, without a copy between them."""

try:
    from array import array

    import uctypes

    def shared(words):
        """(raw, values): `words` int16, little-endian as the processor is, and the same memory as bytes."""
        values = array("h", bytes(2 * words))
        return uctypes.bytearray_at(uctypes.addressof(values), 2 * words), values

except ImportError:

    def shared(words):
        """(raw, values): `words` int16, little-endian as the processor is, and the same memory as bytes."""
        raw = bytearray(2 * words)
        return raw, memoryview(raw).cast("h")
