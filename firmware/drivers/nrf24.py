"""nRF24L01+ (Nordic): packets of up to 32 bytes, with payloads in their acknowledgements.

radio = Nrf24(spi, csn, ce, 76, 1000)
radio.send_to(b"\\xe8\\xb7\\xd6\\xa5\\x01", 15, 500)  # or listen_to([address, ..])
radio.out[1:5] = b"ping"
radio.write(4)
"""

from time import sleep_ms

from machine import SPI, Pin
from micropython import const

_SPI_HZ = const(8000000)
_CONFIG = const(0x00)
_EN_AA = const(0x01)
_EN_RXADDR = const(0x02)
_SETUP_AW = const(0x03)
_SETUP_RETR = const(0x04)
_RF_CH = const(0x05)
_RF_SETUP = const(0x06)
_STATUS = const(0x07)
_RPD = const(0x09)
_RX_ADDR_P0 = const(0x0A)
_TX_ADDR = const(0x10)
_FIFO_STATUS = const(0x17)
_DYNPD = const(0x1C)
_FEATURE = const(0x1D)
_WRITE = const(0x20)
_WIDTH = const(0x60)
_READ_PAYLOAD = const(0x61)
_WRITE_PAYLOAD = const(0xA0)
_WRITE_ANSWER = const(0xA8)
_WRITE_UNSURE = const(0xB0)
_FLUSH_TX = const(0xE1)
_FLUSH_RX = const(0xE2)
_NOP = const(0xFF)

_POWERED = const(0x0E)  # CONFIG: CRC of two bytes, powered
_LISTENS = const(0x01)
_TX_EMPTY = const(0x10)  # bit of FIFO_STATUS
_DRAIN_MS = const(100)
_ALL_PIPES = const(0x3F)
_WIDTH_5 = const(0x03)
_DYNAMIC = const(0x07)  # dynamic length, payloads in acknowledgements, packets without acknowledgement
RX_DR = const(0x40)
TX_DS = const(0x20)
MAX_RT = const(0x10)
TX_FULL = const(0x01)
NONE = const(7)
"""Pipe number when the receive FIFO is empty."""
MAX_PACKET = const(32)
_RATES = {250: 0x26, 1000: 0x06, 2000: 0x0E}


class Nrf24:
    """Driver of the radio. out: command and up to 32 bytes to send; came: status and received bytes.

    Raises OSError when no such chip answers, ValueError for a rate that it does not have.
    """

    def __init__(self, spi, csn, ce, channel, kbps):
        self._spi, self._csn, self._ce = spi, csn, ce
        self.out = bytearray(1 + MAX_PACKET)
        self.came = bytearray(1 + MAX_PACKET)
        out, came = memoryview(self.out), memoryview(self.came)
        self._outs = tuple(out[:size] for size in range(2 + MAX_PACKET))
        self._cames = tuple(came[:size] for size in range(2 + MAX_PACKET))
        self._nop = bytearray([_NOP])
        self._one = bytearray(1)
        if kbps not in _RATES:
            raise ValueError("radio_kbps {}: want 250, 1000 or 2000".format(kbps))
        ce.value(0)
        sleep_ms(5)
        self._set(_SETUP_AW, _WIDTH_5)
        self._set(_RF_CH, channel)
        if self._get(_SETUP_AW) != _WIDTH_5 or self._get(_RF_CH) != channel:
            raise OSError("no nRF24L01+ on SPI")
        self._set(_RF_SETUP, _RATES[kbps])
        self._set(_FEATURE, _DYNAMIC)
        self._set(_DYNPD, _ALL_PIPES)
        self._set(_EN_AA, _ALL_PIPES)
        self._command(_FLUSH_TX)
        self._command(_FLUSH_RX)
        self.clear(RX_DR | TX_DS | MAX_RT)

    def send_to(self, address, tries, pause_us):
        """Transmit to an address of five bytes, last one first, with `tries` retransmissions."""
        self._set_address(_TX_ADDR, address)
        self._set_address(_RX_ADDR_P0, address)
        self._set(_EN_RXADDR, 1)
        self._set(_SETUP_RETR, (pause_us // 250 - 1) << 4 | tries)
        self._start(_POWERED)

    def listen_to(self, addresses):
        """Receive on up to five addresses that differ in their first byte: pipes 1, 2, .."""
        self._set_address(_RX_ADDR_P0 + 1, addresses[0])
        for pipe in range(1, len(addresses)):
            self._set(_RX_ADDR_P0 + 1 + pipe, addresses[pipe][0])
        self._set(_EN_RXADDR, ((1 << len(addresses)) - 1) << 1)
        self._start(_POWERED | _LISTENS)

    def halt(self):
        """Switch the transmitter off once its FIFO is empty, or has not been acknowledged."""
        for _ in range(_DRAIN_MS):
            if self._get(_FIFO_STATUS) & _TX_EMPTY or self.status() & MAX_RT:
                break
            sleep_ms(1)
        self._ce.value(0)
        self._set(_CONFIG, 0)

    def resume(self):
        """Switch a transmitter on again; the clock of SPI may have changed meanwhile."""
        self._spi.init(baudrate=_SPI_HZ)
        self._start(_POWERED)

    def status(self):
        """Return the status register."""
        self._csn.value(0)
        self._spi.write_readinto(self._nop, self._one)
        self._csn.value(1)
        return self._one[0]

    def clear(self, flags):
        """Clear flags of the status register."""
        self._set(_STATUS, flags)

    def write(self, size, acknowledged=True):
        """Queue out[1:1 + size] for transmission; acknowledged: True to request an acknowledgement."""
        self._payload(_WRITE_PAYLOAD if acknowledged else _WRITE_UNSURE, size)

    def answer(self, pipe, size):
        """Queue out[1:1 + size] as payload of the next acknowledgement on a pipe."""
        self._payload(_WRITE_ANSWER | pipe, size)

    def read(self):
        """Read the oldest received packet to came[1:]; return its length, 0 for none."""
        size = self._get(_WIDTH)
        if not 0 < size <= MAX_PACKET:
            self._command(_FLUSH_RX)
            return 0
        self.out[0] = _READ_PAYLOAD
        self._csn.value(0)
        self._spi.write_readinto(self._outs[1 + size], self._cames[1 + size])
        self._csn.value(1)
        return size

    def is_strong(self):
        """Return True if the last packet was received above -64 dBm."""
        return self._get(_RPD) & 1

    def flush(self):
        """Flush the transmit FIFO."""
        self._command(_FLUSH_TX)

    def _start(self, config):
        self._set(_CONFIG, config)
        sleep_ms(5)
        self._ce.value(1)

    def _payload(self, command, size):
        self.out[0] = command
        self._csn.value(0)
        self._spi.write_readinto(self._outs[1 + size], self._cames[1 + size])
        self._csn.value(1)

    def _command(self, command):
        self._one[0] = command
        self._csn.value(0)
        self._spi.write(self._one)
        self._csn.value(1)

    def _set(self, register, value):
        self.out[0] = _WRITE | register
        self.out[1] = value
        self._csn.value(0)
        self._spi.write(self._outs[2])
        self._csn.value(1)

    def _set_address(self, register, address):
        self._csn.value(0)
        self._spi.write(bytes([_WRITE | register]) + address)
        self._csn.value(1)

    def _get(self, command):
        self.out[0] = command
        self._csn.value(0)
        self._spi.write_readinto(self._outs[2], self._cames[2])
        self._csn.value(1)
        return self.came[1]


def open_radio(board):
    """Return the radio on the pins of a board. Raises as `Nrf24`."""
    pins, settings = board.pins, board.settings
    spi = SPI(
        pins["spi"],
        baudrate=_SPI_HZ,
        sck=Pin(pins["sck"]),
        mosi=Pin(pins["mosi"]),
        miso=Pin(pins["miso"]),
    )
    csn, ce = Pin(pins["csn"], Pin.OUT, value=1), Pin(pins["ce"], Pin.OUT, value=0)
    return Nrf24(spi, csn, ce, settings["radio_channel"], settings["radio_kbps"])


def address_of(net, node_id):
    """Return five bytes, last one first: node id, then the network in hexadecimal digits."""
    return bytes([node_id]) + bytes.fromhex(net)
