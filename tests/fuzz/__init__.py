"""Fuzzing: random inputs and the properties that hold for all of them."""
