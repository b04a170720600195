"""Run firmware on CPython with the modules of the board in place of MicroPython's."""

# Runs in the interpreter of a board, outside the package: without type annotations.
# mypy: ignore-errors

import builtins
import importlib
import io
import os
import random
import sys
import time as real_time
import traceback
import types
from pathlib import Path

# Modules that the firmware imports have to be loaded while `time` is still that of CPython.
for _name in ("array", "binascii", "collections", "errno", "hashlib", "math", "random", "re", "select"):
    importlib.import_module(_name)

RUNNER_FOLDER = Path(__file__).parent
sys.path.insert(0, str(RUNNER_FOLDER))
from board_calls import CONFIG, TICKS_PERIOD, board  # noqa: E402
from board_devices import ExchangeDevice, I2cDevice, Poll, SerialDevice, TextStream, UdpDevice  # noqa: E402

sys.path.remove(str(RUNNER_FOLDER))

FLASH = CONFIG["flash"]


def _module(name, **names):
    """Install a module with these names."""
    module = types.ModuleType(name)
    module.__dict__.update(names)
    sys.modules[name] = module
    return module


def _identity(x=None, *_, **__):
    """Return the argument."""
    return x


def _kbd_intr(char):
    """Set the byte that raises KeyboardInterrupt; -1 for none."""
    board.interrupt_char = char


def _install():
    """Install the modules of the board, and confine file access to its flash."""
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
    devices = {
        "/dev/i2c": I2cDevice,
        "/dev/serial": SerialDevice,
        "/dev/udp": UdpDevice,
        "/dev/spi": lambda: ExchangeDevice("SPI"),
        "/dev/espnow": lambda: ExchangeDevice("ESPNOW"),
        "/dev/ble": lambda: ExchangeDevice("BLE"),
    }
    port_modules = ("espnow", "esp32") if CONFIG["platform"] == "esp32" else ()
    if CONFIG["radio"] or CONFIG["platform"] == "esp32":
        port_modules += ("bluetooth",)
    for name in ("time", "machine", "network", "socket", *port_modules):
        source = RUNNER_FOLDER.parent / "modules" / f"_{name}.py"
        module = types.ModuleType(name)
        module.__dict__["open"] = lambda path, mode: devices[path]()
        exec(compile(source.read_text(), str(source), "exec"), module.__dict__)
        sys.modules[name] = module
    os.chdir(FLASH)
    host_open = builtins.open
    builtins.open = lambda path, *arguments, **options: host_open(_on_flash(path), *arguments, **options)
    for name in ("listdir", "stat", "remove", "unlink", "mkdir", "rmdir"):
        setattr(os, name, _rooted(getattr(os, name)))
    if CONFIG["random_seed"] is not None:
        os.urandom = random.Random(CONFIG["random_seed"]).randbytes
    host_rename = os.rename
    os.rename = lambda a, b: host_rename(_on_flash(a), _on_flash(b))
    sys.path[:0] = [FLASH, FLASH + "/lib"]
    sys.dont_write_bytecode = True
    sys.print_exception = lambda error: sys.stdout.write("".join(traceback.format_exception(error)))
    sys.implementation._machine = CONFIG["machine"]
    sys.stdin = sys.stdout = TextStream()
    sys.platform = CONFIG["platform"] or sys.platform


def _on_flash(path):
    """Return the host path of an absolute path on the board."""
    if (
        isinstance(path, str)
        and path.startswith("/")
        and not path.startswith((FLASH, sys.prefix, sys.base_prefix))
    ):
        return FLASH + path
    return path


def _rooted(function):
    """Return a function of os whose path argument is on the board."""
    return lambda path=".", *arguments, **options: function(_on_flash(path), *arguments, **options)


def _run(name):
    """Run a file of the board; return False if it raised an exception."""
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
    """Request a soft reset of the board."""
    sys.stdout.write("MPY: soft reboot\r\n")
    board.ask("SOFT_RESET", 0)


def main():
    """Run the firmware, then wait for ctrl-D."""
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
