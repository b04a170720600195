"""Runs the node after power-on: the first of SLOTS whose firmware loads.

A host may send any byte meanwhile: ctrl-C is an ordinary one here. `hubodo flash` fills a slot beside the one
that runs, and then puts this file with the new order in the place of the old one: that is the whole switch.
"""

try:
    import micropython

    micropython.kbd_intr(-1)
except KeyboardInterrupt:
    # It came before that was said.
    import micropython

    micropython.kbd_intr(-1)

SLOTS = ("",)


def load(slots):
    """`main` of the firmware; where it does not load, of the next slot, with nothing kept of the first."""
    import sys

    known = tuple(sys.modules)
    sys.path[0] = slots[0]
    try:
        from node import main
    except Exception as error:
        if len(slots) == 1:
            raise
        sys.print_exception(error)
        for name in tuple(sys.modules):
            if name not in known:
                del sys.modules[name]
        return load(slots[1:])
    return main


try:
    load(SLOTS)()
finally:
    micropython.kbd_intr(3)
