"""A node's bytes to timed samples."""
