"""Firmware onto a board: the image, and the conversation that puts it there and proves it."""
