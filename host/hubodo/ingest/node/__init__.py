"""Decoding of a node's frames to samples with host times."""
