"""Prepares the first start of firmware and settings that came over the air.

main.py becomes one that first puts the old main.py back, then starts the new firmware with a watchdog.
Whatever ends that start, the old firmware and its settings return, unless `trial.py` has confirmed it: then
main.py.new and config.json.new have taken their places.
"""

import json
import os

from radio.wire_update import UPDATE_STATUS_COMPLETE, UPDATE_STATUS_NO_OTHER, UPDATE_STATUS_NOT_STORED

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

_FILES_ROOT = "/"
_MAIN = "main.py"
_CONFIG = "config.json"
_START = b"\nload(SLOTS)()\n"
"""Last line of main.py; the first start has _FIRST_START in its place."""
_FIRST_START = b"""
import os
os.rename("/main.py.old", "/main.py")
import machine
machine.WDT(timeout=8000)
config = "/config.json.new"
try:
    load(SLOTS[:1])(config if config[1:] in os.listdir("/") else config[:-4])
except Exception as error:
    import sys
    sys.print_exception(error)
    machine.reset()
"""


def switch(slot):
    """Make main.py.new, and the changes of settings in a file of `slot`, those of the next start."""
    _remove(_CONFIG + ".new")
    changes = slot + "/" + _CONFIG
    values = _read(changes)
    if values:
        settings = _read(_FILES_ROOT + _CONFIG)
        settings.update(values)
        with open(_FILES_ROOT + _CONFIG + ".new", "w") as file:
            json.dump(settings, file)
        os.remove(changes)
    path = _FILES_ROOT + _MAIN
    _copy(path, path + ".old", os.stat(path)[6], b"")
    _copy(path + ".new", path + ".try", os.stat(path + ".new")[6] - len(_START), _FIRST_START)
    os.rename(path + ".try", path)


def select_other(update):
    """Start the firmware of the slot that does not run, unless that is missing or incomplete."""
    status = UPDATE_STATUS_NO_OTHER
    try:
        if _write_main(update.running, update.folder):
            switch(update.folder)
            status = UPDATE_STATUS_COMPLETE
    except OSError:
        status = UPDATE_STATUS_NOT_STORED
    update.end(status)


def _write_main(running, other):
    """Write the main.py.new that starts a slot; return False if it has no firmware, or one half received."""
    try:
        names = os.listdir(other)
    except OSError:
        return False
    if "node.mpy" not in names or "update.txt" in names:
        return False
    slots = 'SLOTS = ("{}", "{}")\n'.format(other, running)
    with open(_FILES_ROOT + _MAIN) as old, open(_FILES_ROOT + _MAIN + ".new", "w") as new:
        for line in old:
            new.write(slots if line.startswith("SLOTS = ") else line)
    return True


def _copy(path, destination, size, tail):
    """Copy the first `size` bytes of a file and append a tail."""
    with open(path, "rb") as source, open(destination, "wb") as copy:
        while size > 0:
            block = source.read(min(size, 128))
            copy.write(block)
            size -= len(block)
        copy.write(tail)


def _read(path) -> "Any":
    try:
        with open(path) as file:
            return json.load(file)
    except (OSError, ValueError):
        return {}


def _remove(name):
    try:
        os.remove(_FILES_ROOT + name)
    except OSError:
        # It does not exist.
        pass
