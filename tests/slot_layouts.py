"""Firmware that reports which of its versions runs, and its layout in the slots of a node."""

import shutil

from hubodo.flash.image import firmware_folder
from hubodo.flash.slots import MAIN, main_for_slot

REPORT_MODULES = """

_main = main


def main(*args):
    import sys

    print("builds", sorted({m.BUILD for m in sys.modules.values() if hasattr(m, "BUILD")}))
    _main(*args)
"""


def firmware(folder, name):
    """Create a firmware with `name` in every file; the node reports whose modules it has loaded."""
    shutil.copytree(firmware_folder(), folder, ignore=shutil.ignore_patterns("__pycache__"))
    for path in folder.rglob("*.py"):
        if path.name != MAIN:
            more = REPORT_MODULES if path.name == "node.py" else ""
            path.write_text(f"{path.read_text()}\nBUILD = {name!r}\n{more}")
    return folder


def lay(image, root, slot):
    """Put an image on a board's file system, in a slot or beside main.py."""
    for name, content in image.items():
        path = root / ("" if name == MAIN else slot.lstrip("/")) / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(main_for_slot(content, slot) if name == MAIN and slot else content)
