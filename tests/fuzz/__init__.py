"""Inputs made from chance, and what must hold whatever they are."""
