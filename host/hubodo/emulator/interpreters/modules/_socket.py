"""MicroPython's module socket of the virtual board: UDP on the network of the board."""

# Runs in MicroPython: without type annotations.
# mypy: ignore-errors

import io

import _board

AF_INET = 2
SOCK_DGRAM = 2
SOL_SOCKET = 0xFFF
SO_REUSEADDR = 4
SO_BROADCAST = 32

_device = open("/dev/udp", "r+b")
_into = _device.readinto
_out = _device.write
_to = _board.udp_destination
_from = _board.udp_from
_result = _board.result


def _packed(host):
    """Return an IPv4 address as two 16-bit halves."""
    a, b, c, d = (int(part) for part in host.split("."))
    return a << 8 | b, c << 8 | d


def getaddrinfo(host, port, *_):
    """Return the address of a numeric host at once; for a name, wait as lwIP does, then fail."""
    if host == "localhost":
        host = "127.0.0.1"
    try:
        _packed(host)
    except ValueError:
        _board.sleep_ms(7000)
        raise OSError(-2) from None
    return [(AF_INET, SOCK_DGRAM, 0, "", (host, port))]


class socket(io.IOBase):
    """A UDP socket."""

    def __init__(self, family=AF_INET, kind=SOCK_DGRAM, proto=0):
        if kind != SOCK_DGRAM:
            raise OSError(95)
        self._handle = _board.udp_open()
        self._timeout = -1
        self._address = None
        self._high = self._low = self._port = 0

    def bind(self, address):
        if isinstance(address, tuple) and _board.udp_bind(self._handle, address[1]) < 0:
            raise OSError(98)

    def connect(self, address):
        self._set_destination(address)

    def _set_destination(self, address):
        """Set the destination."""
        if address is not self._address:
            self._high, self._low = _packed(address[0])
            self._port = address[1]
            self._address = address

    def setblocking(self, on):
        self._timeout = -1 if on else 0

    def settimeout(self, seconds):
        self._timeout = -1 if seconds is None else int(seconds * 1000)

    def setsockopt(self, *_):
        pass

    def sendto(self, buf, address):
        self._set_destination(address)
        return self.send(buf)

    def send(self, buf, at=None, size=None):
        _to(self._handle, self._high, self._low, self._port)
        if size is not None:
            _out(buf, at, size)
        elif at is not None:
            _out(buf, at)
        else:
            _out(buf)
        if _result() < 0:
            raise OSError(-_result())
        return _result()

    write = send

    def readinto(self, buf, nbytes=None):
        _from(self._handle, self._timeout)
        n = _into(buf)
        if _result() < 0:
            if _result() == -11:
                return None
            raise OSError(-_result())
        return n

    def recvfrom(self, size):
        buf = bytearray(size)
        _from(self._handle, self._timeout)
        n = _into(buf)
        if _result() < 0:
            raise OSError(-_result())
        peer = _board.udp_peer
        return bytes(buf[:n]), ("%d.%d.%d.%d" % (peer(0), peer(1), peer(2), peer(3)), peer(4))

    def recv(self, size):
        return self.recvfrom(size)[0]

    def ioctl(self, request, arg):
        if request == 3:
            return arg & ((1 if _board.count(0x100 | self._handle) else 0) | 4)
        return 0

    def close(self):
        _board.udp_close(self._handle)
