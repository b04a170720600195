"""The board of a virtual node: bus, pins, clock, watchdog, link and interpreter."""
