"""A model state: its terms, the start of each node, and the readings it predicts."""
