"""An emulated Raspberry Pi Pico that runs the MicroPython of a real one."""
