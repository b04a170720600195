"""Puts the board's modules in place and the flash at /, before anything of the user's runs."""

# MicroPython's own types: not the host's code, no host types.
# mypy: ignore-errors

import sys

import _board


def start():
    for name in ("time", "machine", "network", "socket", "select", "gc"):
        sys.modules.pop(name, None)
        module = __import__("_" + name)
        sys.modules[name] = module
        del sys.modules["_" + name]
    import os

    sys.path[:] = ["", ".frozen", "/lib"]
    os.umount("/")
    os.mount(os.VfsPosix("/flash"), "/")
    os.chdir("/")
    os.rename, os.ilistdir = _file_calls(os)
    if _board.platform():
        sys.modules["sys"] = _named(sys, _board.platform())
    sys.modules["gc"].collect()


def _named(system, platform):
    """sys with another platform; its own cannot be written to."""

    class Named:
        pass

    for name in dir(system):
        if not name.startswith("__"):
            setattr(Named, name, getattr(system, name))
    Named.platform = platform
    return Named


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
