"""Interpreters of the firmware: MicroPython in WebAssembly, CPython, or an emulated RP2040."""
