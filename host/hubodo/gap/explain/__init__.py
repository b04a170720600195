"""Explanation of a search result: numbers with sigmas, and sentences."""
