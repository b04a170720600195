"""Kinds of factors of the graph, one module each."""
