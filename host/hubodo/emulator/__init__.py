"""Nodes without hardware: chips by their registers, boards by their interpreters, what moves them."""
