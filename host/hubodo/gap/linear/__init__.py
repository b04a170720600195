"""A model linearised about where it stands: how the channels answer every effect."""
