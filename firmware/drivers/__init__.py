"""Chips a node can read: one file each, on what they share."""
