"""What runs a board's firmware: MicroPython in WebAssembly, CPython, an emulated RP2040; each a process."""
