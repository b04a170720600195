"""A node's errors as they were measured: one file format, and what it does to a recording."""
