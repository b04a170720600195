"""Run the node after power-on: the firmware in the first of SLOTS that loads.

The host may send any byte meanwhile, so ctrl-C does not interrupt. `hubodo flash` fills the slot that does
not run, then replaces this file by one with the new order: that single step switches the firmware.
"""


def quiet():
    """Make ctrl-C an ordinary byte; one received just before is raised here, not within an import."""
    from time import sleep_ms

    import micropython

    micropython.kbd_intr(-1)
    sleep_ms(1)


# A ctrl-C before `kbd_intr` costs one attempt, and a host sends at most one per millisecond.
try:
    try:
        quiet()
    except KeyboardInterrupt:
        quiet()
except KeyboardInterrupt:
    quiet()

SLOTS = ("",)


def load(slots):
    """Return `main` of the first slot that loads; modules of a slot that does not are removed."""
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
