"""Runs the node after power-on. A host may send any byte meanwhile: ctrl-C is an ordinary one here."""


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

from node import main  # noqa: E402  only when it is quiet

main()
