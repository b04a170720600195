"""A model as it stands in the search, and what it predicts."""
