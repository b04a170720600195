"""Where MicroPython cannot be had: CPython, with the board's modules in place of its own."""

# Runs in place of MicroPython, outside the package: no host types.
# mypy: ignore-errors

import builtins
import importlib
import io
import json
import os
import struct
import sys
import threading
import time as real_time
import traceback
import types
from pathlib import Path

# What firmware imports has to be loaded while `time` still is CPython's.
for _name in ("array", "binascii", "collections", "errno", "hashlib", "math", "random", "re", "select"):
    importlib.import_module(_name)

CONFIG = json.loads(sys.argv[1])
OP = CONFIG["ops"]
REQUEST_FD, RESPONSE_FD, LIFELINE_FD = CONFIG["pipes"]
STEPPED, PACED = CONFIG["stepped"], CONFIG["paced"]
REQUEST = struct.Struct("<BxhHHd")
RESPONSE = struct.Struct("<hBBId")
FLAG_INPUT, FLAG_ROOM, FLAG_INTERRUPT = 1, 2, 4
TICKS_PERIOD = 1 << 30
NAP_NS = 10e6
HERE = Path(__file__).parent
FLASH = CONFIG["flash"]


def _end_with_the_board():
    os.read(LIFELINE_FD, 1)
    os._exit(1)


class BoardCalls:
    """The calls, as runner.mjs makes them; also what MicroPython-side modules import as `_board`."""

    def __init__(self):
        self.t = CONFIG["t_ns"]
        self.flags = 0
        self.interrupt_char = 3
        self.booting, self.interrupted = True, False
        self.contact = -1e18
        self.rate = 1 + CONFIG["clock_ppm"] * 1e-6
        self.t0 = int(CONFIG["t0_ns"])
        self.status = 0
        self.aim = (0, 0, 0, 1)
        self.port, self.timeout = 0, 0
        self.socket, self.peer, self.armed = 0, bytes(6), False

    def now(self):
        return self.t if STEPPED else real_time.monotonic_ns() - self.t0

    def pace(self, lead):
        ahead = self.t - (real_time.monotonic_ns() - self.t0) / CONFIG["pace"] if PACED else 0
        if ahead > lead:
            real_time.sleep(ahead * CONFIG["pace"] / 1e9)

    def spend(self, ns):
        if STEPPED:
            self.t += ns
            self.pace(2e6)

    def wait_until(self, t):
        if STEPPED:
            self.t = max(self.t, t)
            self.pace(150e3)
            return
        left = t - self.now()
        while left > 0:
            if left > 70e3:
                real_time.sleep((left - 35e3) / 1e9)
            left = t - self.now()

    def ask(self, op, a=0, payload=b""):
        os.write(REQUEST_FD, REQUEST.pack(OP[op], self.interrupt_char, a, len(payload), self.now()) + payload)
        data = os.read(RESPONSE_FD, 1 << 17)
        while len(data) < RESPONSE.size or len(data) < RESPONSE.size + RESPONSE.unpack_from(data)[3]:
            more = os.read(RESPONSE_FD, 1 << 17)
            if not more:
                os._exit(1)
            data += more
        status, self.flags, _, n, t = RESPONSE.unpack_from(data)
        self.wait_until(t)
        self.spend(CONFIG["call_cost_ns"])
        self.contact = self.now()
        if self.flags & FLAG_INTERRUPT:
            self.interrupted = True
        self.check_interrupt()
        return status, data[RESPONSE.size : RESPONSE.size + n]

    def check_interrupt(self):
        """Ctrl-C that came before the user's code is kept for it."""
        if self.interrupted and not self.booting:
            self.interrupted = False
            raise KeyboardInterrupt

    def fresh_flags(self):
        if self.now() - self.contact > CONFIG["refresh_ns"]:
            self.ask("PING")
        else:
            self.spend(CONFIG["tick_cost_ns"])
        return self.flags

    def device_us(self):
        return CONFIG["ticks_start_us"] + (self.now() - CONFIG["t_boot_ns"]) * self.rate / 1000

    def ticks_us(self):
        self.spend(CONFIG["tick_cost_ns"])
        return int(self.device_us()) % TICKS_PERIOD

    def ticks_ms(self):
        self.spend(CONFIG["tick_cost_ns"])
        return int(self.device_us() / 1000) % TICKS_PERIOD

    def sleep_us(self, us):
        self.check_interrupt()
        end = self.now() + us * 1000 / self.rate
        while True:
            self.wait_until(min(end, self.now() + NAP_NS))
            if self.now() - self.contact >= NAP_NS:
                self.ask("PING")
            if self.now() >= end:
                return

    def sleep_ms(self, ms):
        self.sleep_us(ms * 1000)

    def i2c_to(self, bus_mode, to, memory, size):
        self.aim = (bus_mode, to, memory, size)
        self.status = 0

    def result(self):
        return self.status

    def i2c_init(self, bus, frequency, scl, sda):
        return self.ask("I2C_INIT", bus, struct.pack("<Ibb", frequency, scl, sda))[0]

    def i2c_scan(self, bus):
        return self.ask("I2C_SCAN", bus)[1].decode("latin1")

    def pin_init(self, pin, mode, pull):
        return self.ask("PIN_INIT", pin, struct.pack("<bb", mode, pull))[0]

    def pin_set(self, pin, level):
        return self.ask("PIN_SET", pin, bytes([level]))[0]

    def pin_get(self, pin):
        return self.ask("PIN_GET", pin)[0]

    def adc(self, channel):
        return struct.unpack("<H", self.ask("ADC_READ", channel)[1])[0]

    def wdt(self, start, ms):
        return self.ask("WDT", start, struct.pack("<I", ms))[0]

    def reset(self):
        self.ask("RESET")

    def serial_to(self, port, timeout_ms):
        self.port, self.timeout = port, timeout_ms

    def count(self, port):
        return self.ask("COUNT", port)[0]

    def uart_init(self, port, baud, to_send, to_read):
        return self.ask("UART_INIT", port, struct.pack("<IHH", baud, to_send, to_read))[0]

    def wlan(self, what):
        return self.ask("WLAN", what)[0]

    def udp_open(self):
        return self.ask("UDP_OPEN")[0]

    def udp_bind(self, handle, port):
        return self.ask("UDP_BIND", handle, struct.pack("<H", port))[0]

    def udp_close(self, handle):
        return self.ask("UDP_CLOSE", handle)[0]

    def udp_to(self, handle, high, low, port):
        self.socket, self.status = handle, 0
        self.peer = struct.pack(">HH", high, low) + struct.pack("<H", port)

    def udp_from(self, handle, timeout_ms):
        self.socket, self.timeout, self.status, self.armed = handle, timeout_ms, 0, True

    def udp_peer(self, k):
        return self.peer[k] if k < 4 else struct.unpack_from("<H", self.peer, 4)[0]

    def unique_id(self):
        return CONFIG["unique_id"]

    def reset_cause(self):
        return CONFIG["reset_cause"]

    def register(self, address):
        return CONFIG["registers"].get(address, 0)

    def machine_name(self):
        return CONFIG["machine"]

    def platform(self):
        return CONFIG["platform"]

    def radio(self):
        return CONFIG["radio"]

    def pin_exists(self, pin):
        return pin in CONFIG["pins"]

    def pin_measures(self, pin):
        return pin in CONFIG["adc_pins"]

    def i2c_count(self):
        return CONFIG["i2c_count"]

    def uart_count(self):
        return CONFIG["uart_count"]

    def frequency(self):
        return CONFIG["frequency_hz"]

    def heap_bytes(self):
        return CONFIG["heap_bytes"]

    def write_port(self, port, data):
        sent = 0
        while sent < len(data):
            sent += self.ask("WRITE", port, bytes(data[sent : sent + 32768]))[0]
        return sent

    def read_port(self, port, most, timeout_ms):
        return self.ask("READ", port, struct.pack("<Ii", most, timeout_ms))[1]


board = BoardCalls()


def _part(buf, part):
    view = memoryview(buf)
    if len(part) == 1:
        return bytes(view[: part[0]])
    return bytes(view[part[0] : part[0] + part[1]]) if part else bytes(view)


class I2cDevice:
    """/dev/i2c of runner.mjs."""

    def readinto(self, buf):
        mode, address, memory, size = board.aim
        request = struct.pack("<BBHH", address, size, memory, len(buf))
        board.status, data = board.ask("I2C_READ" if mode & 1 else "I2C_READ_MEM", mode >> 1, request)
        memoryview(buf).cast("B")[: len(data)] = data
        return len(data)

    def write(self, buf, *part):
        mode, address, memory, size = board.aim
        request = struct.pack("<BBH", address, size, memory) + _part(buf, part)
        board.status, _ = board.ask("I2C_WRITE" if mode & 1 else "I2C_WRITE_MEM", mode >> 1, request)
        return len(buf)


class SerialDevice:
    """/dev/serial of runner.mjs."""

    def readinto(self, buf):
        data = board.read_port(board.port, len(buf), board.timeout)
        buf[: len(data)] = data
        return len(data)

    def write(self, buf, *part):
        return board.ask("WRITE", board.port, _part(buf, part))[0]


class UdpDevice:
    """/dev/udp of runner.mjs."""

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


class Bytes:
    """sys.stdin.buffer and sys.stdout.buffer."""

    def write(self, buf, *part):
        return board.write_port(0, _part(buf, part))

    def readinto(self, buf):
        view, at = memoryview(buf), 0
        while at < len(view):
            data = board.read_port(0, len(view) - at, 100)
            view[at : at + len(data)] = data
            at += len(data)
        return at

    def read(self, n=1):
        buf = bytearray(n)
        self.readinto(buf)
        return bytes(buf)

    def flush(self):
        pass


class Text:
    """sys.stdin and sys.stdout."""

    encoding = "utf-8"

    def __init__(self):
        self.buffer = Bytes()

    def write(self, text):
        self.buffer.write(text.encode())
        return len(text)

    def read(self, n=1):
        return self.buffer.read(n).decode("latin1")

    def flush(self):
        pass

    def ioctl(self, request, flags):
        have = board.fresh_flags()
        return flags & ((1 if have & FLAG_INPUT else 0) | (4 if have & FLAG_ROOM else 0))


class Poll:
    """select.poll over objects with ioctl, as MicroPython's."""

    def __init__(self):
        self._entries = {}

    def register(self, thing, flags=5):
        self._entries[id(thing)] = (thing, flags)

    modify = register

    def unregister(self, thing):
        self._entries.pop(id(thing), None)

    def ipoll(self, timeout_ms=-1, flags=0):
        end = None if timeout_ms < 0 else board.now() + timeout_ms * 1e6
        while True:
            ready = [(thing, got) for thing, mask in self._entries.values() if (got := thing.ioctl(3, mask))]
            if ready or (end is not None and board.now() >= end):
                return ready
            board.sleep_us(500)

    poll = ipoll


def _module(name, **names):
    module = types.ModuleType(name)
    module.__dict__.update(names)
    sys.modules[name] = module
    return module


def _identity(x=None, *_, **__):
    return x


def _kbd_intr(char):
    board.interrupt_char = char


def _install():
    _module("_board", **{name: getattr(board, name) for name in dir(board) if not name.startswith("__")})
    _module(
        "micropython",
        const=_identity,
        kbd_intr=_kbd_intr,
        heap_lock=_identity,
        heap_unlock=_identity,
        mem_info=_identity,
        opt_level=_identity,
        native=_identity,
        alloc_emergency_exception_buf=_identity,
        schedule=lambda function, argument: function(argument),
    )
    _module("select", poll=Poll, POLLIN=1, POLLOUT=4, POLLERR=8, POLLHUP=16)
    half = TICKS_PERIOD // 2
    _module(
        "time",
        ticks_add=lambda ticks, delta: (ticks + delta) % TICKS_PERIOD,
        ticks_diff=lambda end, start: (end - start + half) % TICKS_PERIOD - half,
        ticks_cpu=board.ticks_us,
        **{name: getattr(real_time, name) for name in ("gmtime", "localtime", "mktime", "time", "time_ns")},
    )
    import gc

    gc.mem_alloc = lambda: 0
    gc.mem_free = lambda: CONFIG["heap_bytes"]
    io.IOBase = object
    devices = {"/dev/i2c": I2cDevice, "/dev/serial": SerialDevice, "/dev/udp": UdpDevice}
    for name in ("time", "machine", "network", "socket"):
        source = HERE.parent / "modules" / f"_{name}.py"
        module = types.ModuleType(name)
        module.__dict__["open"] = lambda path, mode: devices[path]()
        exec(compile(source.read_text(), str(source), "exec"), module.__dict__)
        sys.modules[name] = module
    os.chdir(FLASH)
    really_open = builtins.open
    builtins.open = lambda path, *rest, **named: really_open(_on_flash(path), *rest, **named)
    for name in ("listdir", "stat", "remove", "unlink", "mkdir", "rmdir"):
        setattr(os, name, _rooted(getattr(os, name)))
    really_rename = os.rename
    os.rename = lambda a, b: really_rename(_on_flash(a), _on_flash(b))
    sys.path[:0] = [FLASH, FLASH + "/lib"]
    sys.dont_write_bytecode = True
    sys.implementation._machine = CONFIG["machine"]
    sys.stdin = sys.stdout = Text()
    sys.platform = CONFIG["platform"] or sys.platform


def _on_flash(path):
    if (
        isinstance(path, str)
        and path.startswith("/")
        and not path.startswith((FLASH, sys.prefix, sys.base_prefix))
    ):
        return FLASH + path
    return path


def _rooted(function):
    return lambda path=".", *rest, **named: function(_on_flash(path), *rest, **named)


def _run(name):
    path = os.path.join(FLASH, name)
    if not os.path.exists(path):
        return True
    _kbd_intr(3)
    board.booting = False
    try:
        with open(path) as file:
            exec(compile(file.read(), path, "exec"), {"__name__": "__main__"})
    except SystemExit:
        _soft_reset()
    except BaseException:
        board.interrupt_char = -1
        sys.stdout.write(traceback.format_exc().replace("\n", "\r\n"))
        return False
    finally:
        board.interrupt_char = -1
    return True


def _soft_reset():
    sys.stdout.write("MPY: soft reboot\r\n")
    board.ask("SOFT_RESET", 0)


def main():
    threading.Thread(target=_end_with_the_board, daemon=True).start()
    _install()
    board.ask("PING")
    for name in CONFIG["run"]:
        if not _run(name):
            break
    board.ask("IDLE")
    sys.stdout.write("\r\nCPython in place of MicroPython: no prompt here, ctrl-D restarts\r\n")
    while True:
        if b"\x04" in board.read_port(0, 256, 500):
            _soft_reset()


main()
