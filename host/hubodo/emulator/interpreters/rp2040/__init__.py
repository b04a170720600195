"""An emulated Raspberry Pi Pico that runs the MicroPython which real ones run."""
