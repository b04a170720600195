"""The problem to be solved: a log matched with a model."""
