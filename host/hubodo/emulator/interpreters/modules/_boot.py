"""Puts the board's modules in place and the flash at /, before anything of the user's runs."""

# MicroPython's own types: not the host's code, no host types.
# mypy: ignore-errors

import sys

import _board


def start():
    own = ("espnow",) if _board.platform() == "esp32" else ()
    for name in ("time", "machine", "network", "socket", "select", "gc") + own:
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
    """sys.implementation of the board; the bytecode stays that of this interpreter."""

    name = sys.implementation.name
    version = sys.implementation.version
    _machine = _board.machine_name()
    _mpy = sys.implementation._mpy


class _Sys:
    """sys, as it calls itself on the board."""

    platform = _board.platform()
    implementation = _Implementation()

    def __getattr__(self, name):
        return getattr(sys, name)


def _file_calls(os):
    """rename, which VfsPosix below a prefix gets wrong, and ilistdir with the sizes that boards give."""
    names = os.ilistdir

    def whole(path):
        return path if path.startswith("/") else os.getcwd().rstrip("/") + "/" + path

    def rename(old, new):
        error = _board.rename(whole(old), whole(new))
        if error:
            raise OSError(error)

    def ilistdir(path=""):
        folder = path.rstrip("/") + "/" if path else ""
        for entry in names(path) if path else names():
            yield (entry[0], entry[1], 0, 0 if entry[1] & 0x4000 else os.stat(folder + entry[0])[6])

    return rename, ilistdir
