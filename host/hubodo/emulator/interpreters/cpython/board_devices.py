"""Device files, standard streams and select.poll of the board, for firmware that runs on CPython."""

# Runs in the interpreter of a board, outside the package: without type annotations.
# mypy: ignore-errors

import struct

from board_calls import board

FLAG_INPUT, FLAG_ROOM = 1, 2


def _part(buf, part):
    """Return the bytes of a buffer, or those of an offset and size."""
    view = memoryview(buf)
    if len(part) == 1:
        return bytes(view[: part[0]])
    return bytes(view[part[0] : part[0] + part[1]]) if part else bytes(view)


class I2cDevice:
    """The device /dev/i2c of runner.mjs."""

    def readinto(self, buf):
        mode, address, memory, size = board.transfer_target
        request = struct.pack("<BBHH", address, size, memory, len(buf))
        board.status, data = board.ask("I2C_READ" if mode & 1 else "I2C_READ_MEM", mode >> 1, request)
        memoryview(buf).cast("B")[: len(data)] = data
        return len(data)

    def write(self, buf, *part):
        mode, address, memory, size = board.transfer_target
        request = struct.pack("<BBH", address, size, memory) + _part(buf, part)
        board.status, _ = board.ask("I2C_WRITE" if mode & 1 else "I2C_WRITE_MEM", mode >> 1, request)
        return len(buf)


class SerialDevice:
    """The device /dev/serial of runner.mjs."""

    def readinto(self, buf):
        data = board.read_port(board.port, len(buf), board.timeout)
        buf[: len(data)] = data
        return len(data)

    def write(self, buf, *part):
        return board.ask("WRITE", board.port, _part(buf, part))[0]


class ExchangeDevice:
    """The devices /dev/spi, /dev/espnow and /dev/ble of runner.mjs: write a request, then read the reply."""

    def __init__(self, op):
        self._op, self._reply = op, b""

    def write(self, buf, *part):
        board.status, self._reply = board.ask(self._op, board.spi_unit, _part(buf, part))
        return len(self._reply)

    def readinto(self, buf):
        data = self._reply[: len(buf)]
        memoryview(buf).cast("B")[: len(data)] = data
        return len(data)


class UdpDevice:
    """The device /dev/udp of runner.mjs."""

    def readinto(self, buf):
        board.status, data = board.ask("UDP_RECV", board.socket, struct.pack("<Ii", len(buf), board.timeout))
        if board.status < 0:
            return 0
        board.peer = data[:6]
        buf[: len(data) - 6] = data[6:]
        return len(data) - 6

    def write(self, buf, *part):
        board.status, _ = board.ask("UDP_SEND", board.socket, board.peer + _part(buf, part))
        return len(buf)


class BinaryStream:
    """Binary standard streams: sys.stdin.buffer and sys.stdout.buffer."""

    def write(self, buf, *part):
        return board.write_port(0, _part(buf, part))

    def readinto(self, buf):
        view, position = memoryview(buf), 0
        while position < len(view):
            data = board.read_port(0, len(view) - position, 100)
            view[position : position + len(data)] = data
            position += len(data)
        return position

    def read(self, n=1):
        buf = bytearray(n)
        self.readinto(buf)
        return bytes(buf)

    def flush(self):
        pass


class TextStream:
    """Text standard streams: sys.stdin and sys.stdout."""

    encoding = "utf-8"

    def __init__(self):
        self.buffer = BinaryStream()

    def write(self, text):
        self.buffer.write(text.encode())
        return len(text)

    def read(self, n=1):
        return self.buffer.read(n).decode("latin1")

    def flush(self):
        pass

    def ioctl(self, request, flags):
        board_flags = board.fresh_flags()
        return flags & ((1 if board_flags & FLAG_INPUT else 0) | (4 if board_flags & FLAG_ROOM else 0))


class Poll:
    """MicroPython's select.poll over objects with ioctl."""

    def __init__(self):
        self._entries = {}

    def register(self, stream, flags=5):
        self._entries[id(stream)] = (stream, flags)

    modify = register

    def unregister(self, stream):
        self._entries.pop(id(stream), None)

    def ipoll(self, timeout_ms=-1, flags=0):
        end = None if timeout_ms < 0 else board.now() + timeout_ms * 1e6
        while True:
            ready = [
                (stream, events)
                for stream, mask in self._entries.values()
                if (events := stream.ioctl(3, mask))
            ]
            if ready or (end is not None and board.now() >= end):
                return ready
            board.sleep_us(500)

    poll = ipoll
