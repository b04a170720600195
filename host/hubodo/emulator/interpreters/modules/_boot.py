"""Install the modules of the board and mount the flash at /, before any user code runs."""

# Runs in MicroPython: without type annotations.
# mypy: ignore-errors

import sys

import _board


def start():
    """Install the modules of the board and mount its flash."""
    port_modules = ("espnow", "esp32") if _board.platform() == "esp32" else ()
    if _board.radio() or _board.platform() == "esp32":
        port_modules += ("bluetooth",)
    for name in ("time", "machine", "network", "socket", "select", "gc") + port_modules:
        sys.modules.pop(name, None)
        module = __import__("_" + name)
        sys.modules[name] = module
        del sys.modules["_" + name]
    import os

    sys.modules["sys"] = _Sys()
    sys.path[:] = ["", ".frozen", "/lib"]
    os.umount("/")
    os.mount(os.VfsPosix("/flash"), "/")
    os.chdir("/")
    os.rename, os.ilistdir = _file_calls(os)
    sys.modules["gc"].collect()


class _Implementation:
    """The board's sys.implementation; the bytecode version is that of this interpreter."""

    name = sys.implementation.name
    version = sys.implementation.version
    _machine = _board.machine_name()
    _mpy = sys.implementation._mpy


class _Sys:
    """The module sys with the names of the board."""

    platform = _board.platform()
    implementation = _Implementation()

    def __getattr__(self, name):
        return getattr(sys, name)


def _file_calls(os):
    """Return os.rename and os.ilistdir of the board.

    VfsPosix below a prefix breaks rename, and its ilistdir lacks the sizes that boards return.
    """
    names = os.ilistdir

    def absolute(path):
        return path if path.startswith("/") else os.getcwd().rstrip("/") + "/" + path

    def rename(old, new):
        error = _board.rename(absolute(old), absolute(new))
        if error:
            raise OSError(error)

    def ilistdir(path=""):
        folder = path.rstrip("/") + "/" if path else ""
        for entry in names(path) if path else names():
            yield (entry[0], entry[1], 0, 0 if entry[1] & 0x4000 else os.stat(folder + entry[0])[6])

    return rename, ilistdir
