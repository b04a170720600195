"""The second look: the best candidates fitted in full."""
