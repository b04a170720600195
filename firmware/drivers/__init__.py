"""Chips a node can read: one flat file each."""
