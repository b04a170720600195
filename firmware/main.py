"""Runs the node after power-on. A host may send any byte meanwhile: ctrl-C is an ordinary one here."""

try:
    import micropython

    micropython.kbd_intr(-1)
except KeyboardInterrupt:
    # It came before that was said.
    import micropython

    micropython.kbd_intr(-1)

try:
    from node import main

    main()
finally:
    micropython.kbd_intr(3)
