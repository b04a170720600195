"""Base class of the links whose carrier transports packets: UDP, Bluetooth, and both sealed."""

from link import Link


class PacketLink(Link):
    """A link by packets. A subclass defines `is_open`, `send_packet` and `receive_packet`."""

    packet_bytes = 0
    """Size of the largest packet that the carrier takes."""
    connections = 0
    """Number of connections so far; constant for a carrier without connections."""

    def __init__(self, size):
        super().__init__()
        self._raw = bytearray(size)
        self._at = self._end = 0

    def is_open(self):
        """Return True if packets can be sent."""
        raise NotImplementedError

    def can_send(self):
        """Return False while frames have to wait, so that no seal is computed in vain."""
        return True

    def send_packet(self, raw, at, size):
        """Send raw[at:at + size] as one packet; return a false value if the carrier does not accept it."""
        raise NotImplementedError

    def receive_packet(self, raw):
        """Copy the next packet to `raw`; return its size, 0 without one."""
        raise NotImplementedError

    def drop(self):
        """End the connection to a peer that does not prove the key, where the carrier has connections."""

    def _accept(self, raw, at, size):
        if size > self.packet_bytes:
            size = self.packet_bytes
        return size if size and self.can_send() and self.send_packet(raw, at, size) else 0

    def _byte(self):
        if self._at == self._end:
            self._at = 0
            self._end = self.receive_packet(self._raw)
            if self._at == self._end:
                return -1
        byte = self._raw[self._at]
        self._at += 1
        return byte
