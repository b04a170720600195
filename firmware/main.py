"""Runs the node after power-on: the first of SLOTS whose firmware loads.

A host may send any byte meanwhile: ctrl-C is an ordinary one here. `hubodo flash` fills a slot beside the one
that runs, and then puts this file with the new order in the place of the old one: that is the whole switch.
"""


def quiet():
    """Ctrl-C is an ordinary byte from here on; one that came just before is raised now, not in an import."""
    from time import sleep_ms

    import micropython

    micropython.kbd_intr(-1)
    sleep_ms(1)


# A ctrl-C that comes before `kbd_intr` costs one try, and a host sends at most one in a millisecond.
try:
    try:
        quiet()
    except KeyboardInterrupt:
        quiet()
except KeyboardInterrupt:
    quiet()

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


load(SLOTS)()
