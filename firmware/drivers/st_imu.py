"""Base class of the six-axis chips of ST: output registers, data-ready, thermometer."""

from buffers import shared
from micropython import const

from drivers.chip import Chip

_STATUS = const(0x1E)
_OUT_TEMP = const(0x20)
_XLDA_GDA = const(0x03)


class StImu(Chip):
    """Reads one sample, polled, and the temperature; a subclass adds settings and FIFO."""

    IS_TAGGED = False
    """True if each word of the FIFO has a tag."""

    def __init__(self, i2c, address):
        super().__init__(i2c, address)
        self.temperature_raw = self.realigned = 0
        self._burst, self._burst_words = shared(8)
        self._status = bytearray(4)

    def ready(self):
        """Return True if a new sample of both triads is available.

        Polling with `read_into` instead may lose a sample: one that arrives during the burst clears the flag.
        """
        self.i2c.readfrom_mem_into(self.address, _STATUS, self._byte)
        return self._byte[0] & _XLDA_GDA == _XLDA_GDA

    def read_into(self, words, at):
        """Read a sample of six words to words[at] in one burst; return 0 if there is no new one, else 1."""
        self.i2c.readfrom_mem_into(self.address, _STATUS, self._burst)
        if self._burst[0] & _XLDA_GDA != _XLDA_GDA:
            return 0
        burst = self._burst_words
        self.temperature_raw = burst[1]
        words[at] = burst[2]
        words[at + 1] = burst[3]
        words[at + 2] = burst[4]
        words[at + 3] = burst[5]
        words[at + 4] = burst[6]
        words[at + 5] = burst[7]
        return 1

    def read_temperature(self):
        """Update `temperature_raw`, which samples in the FIFO do not contain."""
        raw = self._status
        self.i2c.readfrom_mem_into(self.address, _OUT_TEMP, raw)
        value = raw[0] | raw[1] << 8
        self.temperature_raw = value - 65536 if value & 0x8000 else value
